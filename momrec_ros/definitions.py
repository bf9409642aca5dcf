"""Definitions and type hashes of the messages that bags from momrec carry, as ROS 2 Jazzy has them.

A bag is self-describing: every schema holds its definition with those of all types inside it, and
every topic the hash of its type (REP 2011, REP 2016).
"""

from __future__ import annotations

__all__ = ["TYPE_HASHES", "message_definition"]

SEPARATOR = "=" * 80

# One entry a type, without those inside it; names as definitions write them.
DEFINITIONS = {
    "builtin_interfaces/Duration": """\
int32 sec
uint32 nanosec
""",
    "builtin_interfaces/Time": """\
int32 sec
uint32 nanosec
""",
    "diagnostic_msgs/DiagnosticArray": """\
std_msgs/Header header
diagnostic_msgs/DiagnosticStatus[] status
""",
    "diagnostic_msgs/DiagnosticStatus": """\
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
""",
    "diagnostic_msgs/KeyValue": """\
string key
string value
""",
    "geometry_msgs/Point": """\
float64 x
float64 y
float64 z
""",
    "geometry_msgs/Point32": """\
float32 x
float32 y
float32 z
""",
    "geometry_msgs/Polygon": """\
geometry_msgs/Point32[] points
""",
    "geometry_msgs/PolygonStamped": """\
std_msgs/Header header
geometry_msgs/Polygon polygon
""",
    "geometry_msgs/Pose": """\
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
""",
    "geometry_msgs/PoseStamped": """\
std_msgs/Header header
geometry_msgs/Pose pose
""",
    "geometry_msgs/Quaternion": """\
float64 x
float64 y
float64 z
float64 w
""",
    "geometry_msgs/Vector3": """\
float64 x
float64 y
float64 z
""",
    "geometry_msgs/Transform": """\
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
""",
    "geometry_msgs/TransformStamped": """\
std_msgs/Header header
string child_frame_id
geometry_msgs/Transform transform
""",
    "sensor_msgs/CameraInfo": """\
std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
sensor_msgs/RegionOfInterest roi
""",
    "sensor_msgs/CompressedImage": """\
std_msgs/Header header
string format
uint8[] data
""",
    "sensor_msgs/Image": """\
std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
""",
    "sensor_msgs/RegionOfInterest": """\
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
""",
    "shape_msgs/Mesh": """\
shape_msgs/MeshTriangle[] triangles
geometry_msgs/Point[] vertices
""",
    "shape_msgs/MeshTriangle": """\
uint32[3] vertex_indices
""",
    "std_msgs/ColorRGBA": """\
float32 r
float32 g
float32 b
float32 a
""",
    "std_msgs/Header": """\
builtin_interfaces/Time stamp
string frame_id
""",
    "std_msgs/String": "string data\n",
    "tf2_msgs/TFMessage": """\
geometry_msgs/TransformStamped[] transforms
""",
    "visualization_msgs/Marker": """\
int32 ARROW=0
int32 CUBE=1
int32 SPHERE=2
int32 CYLINDER=3
int32 LINE_STRIP=4
int32 LINE_LIST=5
int32 CUBE_LIST=6
int32 SPHERE_LIST=7
int32 POINTS=8
int32 TEXT_VIEW_FACING=9
int32 MESH_RESOURCE=10
int32 TRIANGLE_LIST=11
int32 ARROW_STRIP=12
int32 ADD=0
int32 MODIFY=0
int32 DELETE=2
int32 DELETEALL=3
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
std_msgs/ColorRGBA color
builtin_interfaces/Duration lifetime
bool frame_locked
geometry_msgs/Point[] points
std_msgs/ColorRGBA[] colors
string texture_resource
sensor_msgs/CompressedImage texture
visualization_msgs/UVCoordinate[] uv_coordinates
string text
string mesh_resource
visualization_msgs/MeshFile mesh_file
bool mesh_use_embedded_materials
""",
    "visualization_msgs/MarkerArray": """\
visualization_msgs/Marker[] markers
""",
    "visualization_msgs/MeshFile": """\
string filename
uint8[] data
""",
    "visualization_msgs/UVCoordinate": """\
float32 u
float32 v
""",
}

TYPE_HASHES = {
    "diagnostic_msgs/msg/DiagnosticArray": (
        "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
    ),
    "geometry_msgs/msg/PolygonStamped": (
        "RIHS01_b7cf07932f1523d4b4088075945c1a0141f7cd21da87cc940fc61652e9138b46"
    ),
    "geometry_msgs/msg/PoseStamped": (
        "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
    ),
    "sensor_msgs/msg/CameraInfo": (
        "RIHS01_b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"
    ),
    "sensor_msgs/msg/Image": (
        "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
    ),
    "shape_msgs/msg/Mesh": (
        "RIHS01_f2150b82d8ee7e8bc3f396a2b158aefb4b9a5510a474be271ba1268aebb55289"
    ),
    "std_msgs/msg/String": (
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
    ),
    "tf2_msgs/msg/TFMessage": (
        "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
    ),
    "visualization_msgs/msg/Marker": (
        "RIHS01_45b13ccf791f225962bf74e746f9644518855d783a6f42ba0cc14fde2b4f3ce0"
    ),
    "visualization_msgs/msg/MarkerArray": (
        "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf"
    ),
}


def message_definition(type_name: str) -> str:
    """Return the definition of a message with those of all types inside it.

    Parameters
    ----------
    type_name : str
        Such as ``"geometry_msgs/msg/PoseStamped"``.

    Returns
    -------
    definition : str
        In the form of ``ros2msg`` schemas: the message first, the others after a line of ``=``.

    Raises
    ------
    KeyError
        If the type is none of `TYPE_HASHES`.
    """
    top = type_name.replace("/msg/", "/")
    others = [name for name in _types_inside(top, []) if name != top]
    parts = [DEFINITIONS[top], *(f"MSG: {name}\n{DEFINITIONS[name]}" for name in others)]
    return f"{SEPARATOR}\n".join(parts)


def _types_inside(name: str, found: list[str]) -> list[str]:
    """Append a type and, depth first, the types of its fields, each once."""
    if name not in found:
        found.append(name)
        for line in DEFINITIONS[name].splitlines():
            field = line.split()[0].split("[")[0]
            if field in DEFINITIONS:
                _types_inside(field, found)
    return found
