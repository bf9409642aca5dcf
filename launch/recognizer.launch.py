"""Start the recognizer node.

ros2 launch momrec_ros recognizer.launch.py model:=/path/to/model.json contours:=/vision/contours
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "momrec_ros"
INPUTS = ("contours", "contour", "camera_pose", "mask", "camera_info")
PARAMETER_TYPES = {"model": str, "autostart": bool, "use_sim_time": bool}


def generate_launch_description() -> LaunchDescription:
    """Return the node with its arguments."""
    return LaunchDescription([*_arguments(), OpaqueFunction(function=_recognizer)])


def _arguments() -> list[DeclareLaunchArgument]:
    inputs = [
        DeclareLaunchArgument(name, default_value=name, description=f"Topic of the input {name}.")
        for name in INPUTS
    ]
    return [
        DeclareLaunchArgument(
            "params_file",
            default_value=PathJoinSubstitution(
                [FindPackageShare(PACKAGE), "config", "recognizer.yaml"]
            ),
            description="YAML file with the node's parameters.",
        ),
        DeclareLaunchArgument(
            "model",
            default_value="",
            description="Path of the model that names the objects; empty: as in params_file.",
        ),
        DeclareLaunchArgument(
            "autostart",
            default_value="",
            choices=["", "true", "false"],
            description="Whether the node activates itself; empty: as in params_file.",
        ),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="",
            choices=["", "true", "false"],
            description="Whether time comes from /clock; empty: as in params_file.",
        ),
        DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node."),
        *inputs,
        DeclareLaunchArgument(
            "log_level",
            default_value="info",
            description="debug, info, warn, error or fatal; for one logger: NAME:=LEVEL.",
        ),
    ]


def _recognizer(context: LaunchContext) -> list[LifecycleNode]:
    params_file = Path(LaunchConfiguration("params_file").perform(context))
    if not params_file.is_file():
        raise FileNotFoundError(f"Expected a YAML file as params_file, got {params_file}")
    given = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, kind in PARAMETER_TYPES.items()
        if LaunchConfiguration(name).perform(context)
    }
    return [
        LifecycleNode(
            package=PACKAGE,
            executable="recognizer",
            name="recognizer",
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("params_file"), given],
            remappings=[(name, LaunchConfiguration(name)) for name in INPUTS],
            ros_arguments=["--log-level", LaunchConfiguration("log_level")],
            output="screen",
            emulate_tty=True,
        )
    ]
