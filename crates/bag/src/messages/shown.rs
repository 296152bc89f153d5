//! What RViz, Foxglove and `rqt` show.

use super::standard::{Colour, Duration, Header, Point, Pose, Vector3};
use super::{Described, messages};
use crate::cdr::{Cdr, CdrError, CdrReader, CdrWriter};

/// `byte` of a `.msg` file, which is not its `uint8`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Byte(pub u8);

impl Cdr for Byte {
    fn write(&self, to: &mut CdrWriter) {
        self.0.write(to);
    }

    fn read(from: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        Cdr::read(from).map(Self)
    }
}

impl Described for Byte {
    fn name() -> String {
        "byte".into()
    }
}

messages! {
    /// Where a texture is.
    "visualization_msgs/msg/UVCoordinate" Texture { u: f32, v: f32 }
    /// A picture, compressed.
    "sensor_msgs/msg/CompressedImage" Picture { header: Header, format: String, data: Vec<u8> }
    /// A mesh.
    "visualization_msgs/msg/MeshFile" Mesh { filename: String, data: Vec<u8> }
    /// A thing to be drawn; see the constants below.
    "visualization_msgs/msg/Marker" Marker {
        header: Header, ns: String, id: i32, r#type: i32, action: i32, pose: Pose, scale: Vector3, color: Colour,
        lifetime: Duration, frame_locked: bool, points: Vec<Point>, colors: Vec<Colour>, texture_resource: String,
        texture: Picture, uv_coordinates: Vec<Texture>, text: String, mesh_resource: String, mesh_file: Mesh,
        mesh_use_embedded_materials: bool,
    }
    /// Several.
    "visualization_msgs/msg/MarkerArray" MarkerArray { markers: Vec<Marker> }
    /// A name and what belongs to it.
    "diagnostic_msgs/msg/KeyValue" KeyValue { key: String, value: String }
    /// How a part is: 0 well, 1 a warning, 2 an error, 3 stale.
    "diagnostic_msgs/msg/DiagnosticStatus" DiagnosticStatus {
        level: Byte, name: String, message: String, hardware_id: String, values: Vec<KeyValue>,
    }
    /// How several parts are.
    "diagnostic_msgs/msg/DiagnosticArray" DiagnosticArray { header: Header, status: Vec<DiagnosticStatus> }
}

impl Marker {
    /// `type`: an arrow along `points`.
    pub const ARROW: i32 = 0;
    /// `type`: a sphere, or an ellipsoid by its `scale`.
    pub const SPHERE: i32 = 2;
    /// `type`: a line through `points`.
    pub const LINE_STRIP: i32 = 4;
    /// `type`: words that face who looks.
    pub const TEXT: i32 = 9;
    /// `type`: triangles, three of `points` each.
    pub const TRIANGLES: i32 = 11;
    /// `action`: take it away.
    pub const DELETE: i32 = 2;
}
