"""bags.py FOLDER...: reads recordings of the node with rosbags and with mcap's strict reader."""
import collections, pathlib, sys
from mcap.stream_reader import StreamReader
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

for folder in map(pathlib.Path, sys.argv[1:]):
    file = folder / f"{folder.name}_0.mcap"
    with open(file, "rb") as stream:
        records = collections.Counter(type(record).__name__ for record in StreamReader(stream, validate_crcs=True).records)
    assert records["DataEnd"] == records["Footer"] == records["Statistics"] == 1, records
    with open(file, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        summary, header = reader.get_summary(), reader.get_header()
        assert header.profile == "ros2", header
        decoded = collections.Counter(channel.topic for _, channel, _, _ in reader.iter_decoded_messages())
    assert sum(decoded.values()) == summary.statistics.message_count > 100, decoded
    # Standard types come from the releases, with matching type hashes; ours come from the recording.
    for release in (Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY):
        store = get_typestore(release)
        counts = collections.Counter()
        with AnyReader([folder], default_typestore=store) as bag:
            for connection in bag.connections:
                kind = connection.msgtype
                # Humble's Range has no variance; the recording's has.
                is_newer = release == Stores.ROS2_HUMBLE and kind == "sensor_msgs/msg/Range"
                if not kind.startswith("csi5300_msgs") and not is_newer:
                    text = connection.msgdef.data.split("=" * 80)[0]
                    own = get_typestore(release)
                    own.fielddefs.update(get_types_from_msg(text, kind))
                    assert own.hash_rihs01(kind) == store.hash_rihs01(kind), f"{kind}:\n{text}"
            for connection, at, raw in bag.messages():
                message = bag.deserialize(raw, connection.msgtype)
                counts[connection.topic] += 1
                if connection.msgtype == "csi5300_msgs/msg/Bearing":
                    last = message
        assert counts == decoded, (counts, decoded)
    assert counts["/tb3_0/odom"] > 20 and counts["/csi5300_tb3_0/csi"] > 100 and last.peer.startswith("tb3_"), counts
    print(f"{folder.name}: {sum(counts.values())} messages on {len(counts)} topics, as mcap and rosbags read them")
