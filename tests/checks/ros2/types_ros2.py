"""ROS 2 messages for CycloneDDS: ROS 2's type names, fields in the order of its files."""
from dataclasses import dataclass, field
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int8, int32, int64, sequence, uint8, uint16, uint32, uint64

def name(package, kind, part="msg"):
    return f"{package}::{part}::dds_::{kind}_"

@dataclass
class Time(IdlStruct, typename=name("builtin_interfaces", "Time")):
    sec: int32 = 0
    nanosec: uint32 = 0

@dataclass
class Header(IdlStruct, typename=name("std_msgs", "Header")):
    stamp: Time = field(default_factory=Time)
    frame_id: str = ""

@dataclass
class Point(IdlStruct, typename=name("geometry_msgs", "Point")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0

@dataclass
class Vector3(IdlStruct, typename=name("geometry_msgs", "Vector3")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0

@dataclass
class Quaternion(IdlStruct, typename=name("geometry_msgs", "Quaternion")):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0

@dataclass
class Pose(IdlStruct, typename=name("geometry_msgs", "Pose")):
    position: Point = field(default_factory=Point)
    orientation: Quaternion = field(default_factory=Quaternion)

@dataclass
class PoseStamped(IdlStruct, typename=name("geometry_msgs", "PoseStamped")):
    header: Header = field(default_factory=Header)
    pose: Pose = field(default_factory=Pose)

@dataclass
class PoseWithCovariance(IdlStruct, typename=name("geometry_msgs", "PoseWithCovariance")):
    pose: Pose = field(default_factory=Pose)
    covariance: array[float64, 36] = field(default_factory=lambda: [0.0] * 36)

@dataclass
class PoseWithCovarianceStamped(IdlStruct, typename=name("geometry_msgs", "PoseWithCovarianceStamped")):
    header: Header = field(default_factory=Header)
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)

@dataclass
class Twist(IdlStruct, typename=name("geometry_msgs", "Twist")):
    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)

@dataclass
class TwistWithCovariance(IdlStruct, typename=name("geometry_msgs", "TwistWithCovariance")):
    twist: Twist = field(default_factory=Twist)
    covariance: array[float64, 36] = field(default_factory=lambda: [0.0] * 36)

@dataclass
class Odometry(IdlStruct, typename=name("nav_msgs", "Odometry")):
    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)
    twist: TwistWithCovariance = field(default_factory=TwistWithCovariance)

@dataclass
class NoOdometry(IdlStruct, typename=name("nav_msgs", "Odometry")):
    """The same name with other content, as a node of another version may send it."""
    words: str = ""

@dataclass
class Transform(IdlStruct, typename=name("geometry_msgs", "Transform")):
    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)

@dataclass
class TransformStamped(IdlStruct, typename=name("geometry_msgs", "TransformStamped")):
    header: Header = field(default_factory=Header)
    child_frame_id: str = ""
    transform: Transform = field(default_factory=Transform)

@dataclass
class TFMessage(IdlStruct, typename=name("tf2_msgs", "TFMessage")):
    transforms: sequence[TransformStamped] = field(default_factory=list)

@dataclass
class ColorRGBA(IdlStruct, typename=name("std_msgs", "ColorRGBA")):
    r: float32
    g: float32
    b: float32
    a: float32

@dataclass
class Duration(IdlStruct, typename=name("builtin_interfaces", "Duration")):
    sec: int32
    nanosec: uint32

@dataclass
class CompressedImage(IdlStruct, typename=name("sensor_msgs", "CompressedImage")):
    header: Header
    format: str
    data: sequence[uint8]

@dataclass
class UVCoordinate(IdlStruct, typename=name("visualization_msgs", "UVCoordinate")):
    u: float32
    v: float32

@dataclass
class MeshFile(IdlStruct, typename=name("visualization_msgs", "MeshFile")):
    filename: str
    data: sequence[uint8]

@dataclass
class Marker(IdlStruct, typename=name("visualization_msgs", "Marker")):
    header: Header
    ns: str
    id: int32
    type: int32
    action: int32
    pose: Pose
    scale: Vector3
    color: ColorRGBA
    lifetime: Duration
    frame_locked: bool
    points: sequence[Point]
    colors: sequence[ColorRGBA]
    texture_resource: str
    texture: CompressedImage
    uv_coordinates: sequence[UVCoordinate]
    text: str
    mesh_resource: str
    mesh_file: MeshFile
    mesh_use_embedded_materials: bool

@dataclass
class Range(IdlStruct, typename=name("sensor_msgs", "Range")):
    header: Header = field(default_factory=Header)
    radiation_type: uint8 = 0
    field_of_view: float32 = 0.0
    min_range: float32 = 0.0
    max_range: float32 = 0.0
    range: float32 = 0.0
    variance: float32 = 0.0

@dataclass
class Text(IdlStruct, typename=name("std_msgs", "String")):
    data: str = ""

@dataclass
class MarkerArray(IdlStruct, typename=name("visualization_msgs", "MarkerArray")):
    markers: sequence[Marker]

@dataclass
class KeyValue(IdlStruct, typename=name("diagnostic_msgs", "KeyValue")):
    key: str
    value: str

@dataclass
class DiagnosticStatus(IdlStruct, typename=name("diagnostic_msgs", "DiagnosticStatus")):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]

@dataclass
class DiagnosticArray(IdlStruct, typename=name("diagnostic_msgs", "DiagnosticArray")):
    header: Header
    status: sequence[DiagnosticStatus]

@dataclass
class Bearing(IdlStruct, typename=name("csi5300_msgs", "Bearing")):
    header: Header
    peer: str
    mac: str
    state: str
    words: str
    azimuth: float64
    azimuth_sd: float64
    azimuth_body: float64
    mirror: float64
    elevation: float64
    signed_elevation: float64
    range: float64
    range_sd: float64
    coherence: float64
    confidence: float64
    moved: float64
    needed: float64
    age: float64
    pairs: uint32

@dataclass
class Csi(IdlStruct, typename=name("csi5300_msgs", "Csi")):
    header: Header
    mac: str
    frame_count: uint32
    timestamp_low: uint32
    bfee_count: uint16
    n_rx: uint8
    n_tx: uint8
    rssi: array[uint8, 3]
    noise: int8
    agc: uint8
    rate_n_flags: uint16
    antennas: sequence[uint8]
    re: sequence[int8]
    im: sequence[int8]

@dataclass
class Gid(IdlStruct, typename=name("rmw_dds_common", "Gid")):
    data: array[uint8, 16]

@dataclass
class NodeEntitiesInfo(IdlStruct, typename=name("rmw_dds_common", "NodeEntitiesInfo")):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]

@dataclass
class ParticipantEntitiesInfo(IdlStruct, typename=name("rmw_dds_common", "ParticipantEntitiesInfo")):
    gid: Gid
    node_entities_info_seq: sequence[NodeEntitiesInfo]

@dataclass
class TriggerRequest(IdlStruct, typename=name("std_srvs", "Trigger_Request", "srv")):
    """With the header that rmw_cyclonedds writes before a request."""
    client: uint64
    number: int64
    none: uint8

@dataclass
class SelfTestRequest(IdlStruct, typename=name("diagnostic_msgs", "SelfTest_Request", "srv")):
    client: uint64
    number: int64
    none: uint8

@dataclass
class SelfTestResponse(IdlStruct, typename=name("diagnostic_msgs", "SelfTest_Response", "srv")):
    client: uint64
    number: int64
    id: str
    passed: uint8
    status: sequence[DiagnosticStatus]

@dataclass
class TriggerResponse(IdlStruct, typename=name("std_srvs", "Trigger_Response", "srv")):
    client: uint64
    number: int64
    success: bool
    message: str
