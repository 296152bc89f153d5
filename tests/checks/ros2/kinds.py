"""kinds.py PROGRAM RUN: a recording rewritten by other programs (rosbags, mcap), in every supported kind, gives the same logs."""
import hashlib, pathlib, subprocess, sys, tempfile
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

csi5300, run = sys.argv[1], pathlib.Path(sys.argv[2])
convert = pathlib.Path(sys.executable).with_name("rosbags-convert")
TOPICS = ["/tb3_0/odom", "/csi5300_tb3_0/csi"]

def logs(bag):
    """The files that `unbag` writes."""
    with tempfile.TemporaryDirectory() as out:
        done = subprocess.run([csi5300, "unbag", str(bag), "--out", out], capture_output=True, text=True)
        # The node's own recording has poses without a stamp, on a topic that is not rewritten.
        expected = (3, True) if bag == run else (0, False)
        assert (done.returncode, "(poses need a stamp)" in done.stderr) == expected, f"{done.returncode}: {done.stderr}"
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in pathlib.Path(out).iterdir()}

def rewrite(compression, to):
    """Rewrites it with the Python library of MCAP."""
    with open(run / f"{run.name}_0.mcap", "rb") as source, open(to, "wb") as stream:
        writer = Writer(stream, compression=compression, chunk_size=100_000)
        writer.start("ros2")
        channels = {}
        for schema, channel, message in make_reader(source).iter_messages(topics=TOPICS):
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()

with tempfile.TemporaryDirectory() as folder:
    folder = pathlib.Path(folder)
    made = []
    for name, options in {
        "sqlite": ["--dst-storage", "sqlite3"], "sqlite-message": ["--dst-storage", "sqlite3", "--compress", "zstd", "--compress-mode", "message"],
        "sqlite-file": ["--dst-storage", "sqlite3", "--compress", "zstd", "--compress-mode", "file"],
        "mcap-message": ["--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "message"],
        "mcap-file": ["--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "file"],
        "mcap-storage": ["--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "storage"],
        "ros1.bag": [], "ros1-lz4.bag": ["--compress", "lz4"],
    }.items():
        words = [convert, "--src", run, "--dst", folder / name, *options, "--include-topic", *TOPICS]
        done = subprocess.run(words, capture_output=True, text=True)
        assert done.returncode == 0 and (folder / name).exists(), f"{name}: {done.stdout}{done.stderr}"
        made.append(folder / name)
    for compression in (CompressionType.ZSTD, CompressionType.LZ4):
        made.append(folder / f"{compression.name}.mcap")
        rewrite(compression, made[-1])
    expected = logs(run)
    expected = {name: expected[name] for name in ("csi5300_tb3_0_csi.dat", "tb3_0_odom.csv")}
    for bag in made:
        assert logs(bag) == expected, bag.name
    print(f"{len(made)} recordings of other programs give the logs of the node's own: {', '.join(bag.name for bag in made)}")
