"""The node, and RViz with its bearings:
ros2 launch csi5300_msgs csi5300.launch.py config:=/etc/csi5300/robot.toml [program:=csi5300] [rviz:=true]"""
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    view = PathJoinSubstitution([FindPackageShare("csi5300_msgs"), "rviz", "csi5300.rviz"])
    return LaunchDescription([
        DeclareLaunchArgument("config", description="The node's configuration, with a [ros2] table"),
        DeclareLaunchArgument("program", default_value="csi5300"),
        DeclareLaunchArgument("rviz", default_value="false"),
        # SIGINT ends it cleanly: log and recording are complete.
        ExecuteProcess(
            cmd=[LaunchConfiguration("program"), "node", "--config", LaunchConfiguration("config")],
            name="csi5300", output="screen", sigterm_timeout="10",
        ),
        Node(package="rviz2", executable="rviz2", arguments=["-d", view], condition=IfCondition(LaunchConfiguration("rviz"))),
    ])
