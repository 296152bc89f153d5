#!/usr/bin/env bash
# Builds the message package (packaging/ros2/csi5300_msgs) with colcon and ROS 2's own generators from Debian. Stand-ins replace what
# Debian lacks of ROS 2: the generators' meta-packages, and the two messages of other packages that are used. 77: they cannot be
# installed here.
set -euo pipefail
cd "$(dirname "$0")/../.."
packages=(colcon python3-colcon-ros ament-cmake rosidl-cmake rosidl-generator-c-cpp cmake g++)
have() { dpkg-query --show --showformat '${db:Status-Status}\n' "${packages[@]}" 2>/dev/null | grep -cx installed; }
install() { DEBIAN_FRONTEND=noninteractive apt-get install -y --no-remove --no-install-recommends "${packages[@]}"; }
if [ "$(have)" != ${#packages[@]} ]; then
    { install || { apt-get update && install; }; } >/dev/null 2>&1 || { echo "colcon and ROS 2's generators cannot be installed"; exit 77; }
fi
# Debian's packages need Debian's own Python.
export PATH=/usr/bin:/bin:$PATH
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir -p "$folder/src"
cp -r packaging/ros2/csi5300_msgs "$folder/src"

# package NAME CMAKE [DEPENDENCY...]: a package with these lines of CMake.
package() {
    local name=$1 lines=$2
    shift 2
    mkdir -p "$folder/src/$name"
    {
        printf '<package format="3"><name>%s</name><version>0.0.0</version><description>x</description>' "$name"
        printf '<maintainer email="x@example.org">x</maintainer><license>x</license><buildtool_depend>ament_cmake</buildtool_depend>'
        printf '<depend>%s</depend>' "$@"
        printf '<member_of_group>rosidl_interface_packages</member_of_group><export><build_type>ament_cmake</build_type></export></package>'
    } | sed 's,<depend></depend>,,' >"$folder/src/$name/package.xml"
    printf 'cmake_minimum_required(VERSION 3.8)\nproject(%s)\nfind_package(ament_cmake REQUIRED)\n%s\nament_package()\n' "$name" "$lines" \
        >"$folder/src/$name/CMakeLists.txt"
}
generators='find_package(rosidl_generator_c REQUIRED)
find_package(rosidl_generator_cpp REQUIRED)
find_package(rosidl_typesupport_introspection_c REQUIRED)
find_package(rosidl_typesupport_introspection_cpp REQUIRED)
ament_export_dependencies(rosidl_cmake rosidl_generator_c rosidl_generator_cpp rosidl_typesupport_introspection_c rosidl_typesupport_introspection_cpp)'
package rosidl_default_generators "$generators"
package rosidl_default_runtime ''
package builtin_interfaces 'find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${PROJECT_NAME} msg/Time.msg)
ament_export_dependencies(rosidl_default_runtime)' rosidl_default_generators rosidl_default_runtime
package std_msgs 'find_package(rosidl_default_generators REQUIRED)
find_package(builtin_interfaces REQUIRED)
rosidl_generate_interfaces(${PROJECT_NAME} msg/Header.msg DEPENDENCIES builtin_interfaces)
ament_export_dependencies(rosidl_default_runtime)' rosidl_default_generators rosidl_default_runtime builtin_interfaces
mkdir "$folder/src/builtin_interfaces/msg" "$folder/src/std_msgs/msg"
printf 'int32 sec\nuint32 nanosec\n' >"$folder/src/builtin_interfaces/msg/Time.msg"
printf 'builtin_interfaces/Time stamp\nstring frame_id\n' >"$folder/src/std_msgs/msg/Header.msg"

cd "$folder"
colcon --log-base log build --executor sequential --event-handlers console_direct- >build.log 2>&1 || { tail -40 build.log; cat log/latest_build/*/stderr.log; exit 1; }
share=install/csi5300_msgs/share/csi5300_msgs
for file in msg/Bearing.msg msg/Csi.msg msg/Bearing.idl launch/csi5300.launch.py rviz/csi5300.rviz package.xml; do
    [ -e "$share/$file" ] || { echo "$share/$file is not installed"; exit 1; }
done
# Uses the generated structures as a program would.
cat >use.cpp <<'CPP'
#include <csi5300_msgs/msg/bearing.hpp>
#include <csi5300_msgs/msg/csi.hpp>
int main() {
    csi5300_msgs::msg::Bearing bearing;
    bearing.header.frame_id = "odom";
    bearing.azimuth_sd = 0.1;
    csi5300_msgs::msg::Csi csi;
    csi.re.resize(60);
    csi.rssi[2] = 31;
    return bearing.azimuth_sd > 0 && csi.re.size() == 60 && csi.rssi.size() == 3 ? 0 : 1;
}
CPP
includes=()
for library in /usr/include/rosidl_* /usr/include/rcutils; do includes+=(-I "$library"); done
for name in csi5300_msgs std_msgs builtin_interfaces; do includes+=(-I "install/$name/include/$name" -I "install/$name/include"); done
g++ -std=c++17 "${includes[@]}" use.cpp -o use
./use
echo "colcon builds csi5300_msgs; the generated code compiles"
