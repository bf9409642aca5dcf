"""Play a bag of contours to the recognizer, and show in RViz what comes of it.

ros2 launch momrec_ros replay.launch.py rate:=2.0

The bag starts when the node is active, so that no view comes too early. The other arguments of
recognizer.launch.py, such as params_file and contours, can be given as well.
"""

from launch import Action, LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    IncludeLaunchDescription,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
)
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.events.matchers import matches_node_name
from launch_ros.substitutions import FindPackageShare
from lifecycle_msgs.msg import Transition

PACKAGE = "momrec_ros"
NODE = "/recognizer"


def generate_launch_description() -> LaunchDescription:
    """Return the node, the bag and RViz with their arguments."""
    return LaunchDescription([*_arguments(), _recognizer(), *_steps(), _rviz()])


def _shared(*path: str) -> PathJoinSubstitution:
    return PathJoinSubstitution([FindPackageShare(PACKAGE), *path])


def _arguments() -> list[DeclareLaunchArgument]:
    return [
        DeclareLaunchArgument(
            "bag",
            default_value=_shared("bags", "ten_objects"),
            description="Bag to play: a rosbag2 folder or an .mcap file.",
        ),
        DeclareLaunchArgument(
            "model",
            default_value=_shared("models", "ten_objects.json"),
            description="Path of the model that names the objects.",
        ),
        DeclareLaunchArgument(
            "rate", default_value="1.0", description="How many times as fast as recorded to play."
        ),
        _switch("loop", "false", "Whether to play the bag again; equal views count once."),
        _switch("use_sim_time", "false", "Whether time is the bag's, published on /clock."),
        _switch("rviz", "true", "Whether to start RViz; all ends when it is closed."),
        DeclareLaunchArgument(
            "fixed_frame", default_value="world", description="World frame of the bag, for RViz."
        ),
        DeclareLaunchArgument(
            "log_level", default_value="info", description="Of the node; see recognizer.launch.py."
        ),
    ]


def _switch(name: str, default: str, description: str) -> DeclareLaunchArgument:
    return DeclareLaunchArgument(
        name, default_value=default, choices=["true", "false"], description=description
    )


def _recognizer() -> IncludeLaunchDescription:
    passed_on = ("model", "use_sim_time", "log_level")
    arguments = {name: LaunchConfiguration(name) for name in passed_on}
    return IncludeLaunchDescription(
        _shared("launch", "recognizer.launch.py"),
        launch_arguments={**arguments, "namespace": "", "autostart": "false"}.items(),
    )


def _steps() -> list[Action]:
    """Configure the node; once it is configured activate it; once it is active play the bag."""
    activate = _transition(Transition.TRANSITION_ACTIVATE)
    play = OpaqueFunction(function=_player)
    return [
        RegisterEventHandler(
            OnStateTransition(goal_state="inactive", entities=[activate], handle_once=True)
        ),
        RegisterEventHandler(
            OnStateTransition(goal_state="active", entities=[play], handle_once=True)
        ),
        _transition(Transition.TRANSITION_CONFIGURE),
    ]


def _transition(transition_id: int) -> EmitEvent:
    return EmitEvent(
        event=ChangeState(
            lifecycle_node_matcher=matches_node_name(NODE), transition_id=transition_id
        )
    )


def _player(context: LaunchContext) -> list[ExecuteProcess]:
    values = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("bag", "rate", "loop", "use_sim_time")
    }
    # The delay is for the node to find the player, so that it misses no view.
    command = ["ros2", "bag", "play", values["bag"], "--rate", values["rate"], "--delay", "1.0"]
    if values["loop"] == "true":
        command.append("--loop")
    if values["use_sim_time"] == "true":
        command.append("--clock")
    return [ExecuteProcess(cmd=command, output="screen")]


def _rviz() -> Node:
    return Node(
        package="rviz2",
        executable="rviz2",
        arguments=[
            "--display-config",
            _shared("rviz", "momrec.rviz"),
            "--fixed-frame",
            LaunchConfiguration("fixed_frame"),
        ],
        parameters=[{"use_sim_time": LaunchConfiguration("use_sim_time")}],
        condition=IfCondition(LaunchConfiguration("rviz")),
        on_exit=Shutdown(reason="RViz was closed"),
    )
