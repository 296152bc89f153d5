#!/usr/bin/env bash
# The ROS 2 node with Fast DDS, the default of Humble and Jazzy: compiles tests/checks/ros2/fastdds.cpp against Debian's package. Tests
# three ways of discovery: defaults with a network card besides loopback, as on most robots (in a network namespace, if one can be
# made); loopback only, as in Humble; and without multicast, as from Iron on. 77: it cannot be installed here.
set -euo pipefail
cd "$(dirname "$0")/../.."
headers=/usr/include/fastdds/dds/domain/DomainParticipant.hpp
install() { DEBIAN_FRONTEND=noninteractive apt-get install -y --no-remove --no-install-recommends libfastrtps-dev g++; }
if ! { [ -e "$headers" ] && command -v g++; } >/dev/null; then
    { install || { apt-get update && install; }; } >/dev/null 2>&1 || { echo "libfastrtps-dev and g++ cannot be installed"; exit 77; }
fi
command -v python3 >/dev/null || { echo "no Python"; exit 77; }
csi5300=$(scripts/program.sh)
folder=$(mktemp -d)
space=c5-fastdds-$$
clean() {
    ip netns del "$space" 2>/dev/null || true
    rm -rf "$folder"
}
trap clean EXIT
g++ -std=c++17 -O0 tests/checks/ros2/fastdds.cpp -o "$folder/peer" -lfastrtps -lfastcdr -lpthread
cp examples/ros2/*.toml "$folder"
inside=()
ways=(localhost)
if ip netns add "$space" 2>/dev/null && ip -n "$space" link set lo up multicast on 2>/dev/null; then
    inside=(ip netns exec "$space")
    ways=(localhost range default)
    # A network card that leads nowhere: Fast DDS announces its address instead of loopback's.
    if ip -n "$space" link add card type veth peer name other 2>/dev/null; then
        ip -n "$space" address add 192.0.2.5/24 dev card
        ip -n "$space" link set card up multicast on
        ip -n "$space" link set other up
        ip -n "$space" -brief address show
    else
        echo "no second network can be made here: loopback only"
    fi
else
    echo "no network namespace can be made here: on loopback as Humble has it"
fi
"${inside[@]}" python3 tests/checks/ros2/fastdds.py "$csi5300" "$folder" "$folder/peer" "${ways[@]}"
