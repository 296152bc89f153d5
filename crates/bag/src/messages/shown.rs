//! Messages for RViz, Foxglove and `rqt`.

use super::standard::{Colour, Duration, Header, Point, Pose, Vector3};
use super::{Described, messages};
use crate::cdr::{Cdr, CdrError, CdrReader, CdrWriter};

/// `byte` of a `.msg` file, distinct from its `uint8`.
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
    /// A texture coordinate.
    "visualization_msgs/msg/UVCoordinate" Texture { u: f32, v: f32 }
    /// A compressed image.
    "sensor_msgs/msg/CompressedImage" Picture { header: Header, format: String, data: Vec<u8> }
    /// A mesh.
    "visualization_msgs/msg/MeshFile" Mesh { filename: String, data: Vec<u8> }
    /// A shape to draw; see the constants below.
    "visualization_msgs/msg/Marker" Marker {
        header: Header, ns: String, id: i32, r#type: i32, action: i32, pose: Pose, scale: Vector3, color: Colour,
        lifetime: Duration, frame_locked: bool, points: Vec<Point>, colors: Vec<Colour>, texture_resource: String,
        texture: Picture, uv_coordinates: Vec<Texture>, text: String, mesh_resource: String, mesh_file: Mesh,
        mesh_use_embedded_materials: bool,
    }
    /// Several markers.
    "visualization_msgs/msg/MarkerArray" MarkerArray { markers: Vec<Marker> }
    /// A name and its value.
    "diagnostic_msgs/msg/KeyValue" KeyValue { key: String, value: String }
    /// The state of a part: 0 OK, 1 warning, 2 error, 3 stale.
    "diagnostic_msgs/msg/DiagnosticStatus" DiagnosticStatus {
        level: Byte, name: String, message: String, hardware_id: String, values: Vec<KeyValue>,
    }
    /// The states of several parts.
    "diagnostic_msgs/msg/DiagnosticArray" DiagnosticArray { header: Header, status: Vec<DiagnosticStatus> }
}

impl Marker {
    /// `type`: an arrow along `points`.
    pub const ARROW: i32 = 0;
    /// `type`: a sphere, or an ellipsoid by its `scale`.
    pub const SPHERE: i32 = 2;
    /// `type`: a cylinder, upright and round or elliptic by its `scale`.
    pub const CYLINDER: i32 = 3;
    /// `type`: a line strip through `points`.
    pub const LINE_STRIP: i32 = 4;
    /// `type`: text that faces the viewer.
    pub const TEXT: i32 = 9;
    /// `type`: triangles, three of `points` each.
    pub const TRIANGLES: i32 = 11;
    /// `action`: delete.
    pub const DELETE: i32 = 2;
}
