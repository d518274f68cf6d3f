#!/usr/bin/env bash
# rosbags 0.11.9 reads no message, and raises no error, from an MCAP file that has chunk indexes but no message indexes.
# The MCAP specification makes message indexes optional; the file states its 3 messages, and `mcap` reads them.
# Guess before: all 3 messages. Seen, 2026-11-29, Python 3.11:
#   stated 3, by mcap 3, by rosbags 0
# Fails when that changes. Writes into a temporary folder only.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" --quiet --disable-pip-version-check install rosbags==0.11.9 mcap==1.6.0
cat > "$folder/read.py" <<'PY'
import sys
from importlib.metadata import version
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import IndexType, Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

path, kind = Path(sys.argv[1]), "std_msgs/msg/Float64"
store = get_typestore(Stores.ROS2_HUMBLE)
with path.open("wb") as file:
    writer = Writer(file, index_types=IndexType.ALL & ~IndexType.MESSAGE)
    writer.start(profile="ros2", library="")
    channel = writer.register_channel("/x", "cdr", writer.register_schema(kind, "ros2msg", b"float64 data"))
    for at in range(3):
        data = bytes(store.serialize_cdr(store.types[kind](float(at)), kind))
        writer.add_message(channel, log_time=at, data=data, publish_time=at)
    writer.finish()
with path.open("rb") as file:
    reader = make_reader(file)
    stated = reader.get_summary().statistics.message_count
    by_mcap = sum(1 for _ in reader.iter_messages())
with AnyReader([path], default_typestore=store) as bag:
    by_rosbags = sum(1 for _ in bag.messages())
print(*(f"{name} {version(name)}" for name in ("rosbags", "mcap")), sep=", ")
print(f"stated {stated}, by mcap {by_mcap}, by rosbags {by_rosbags}")
PY
"$folder/venv/bin/python" "$folder/read.py" "$folder/a.mcap" | tee "$folder/said"
grep -qx "stated 3, by mcap 3, by rosbags 0" "$folder/said" || { echo "changed" >&2; exit 1; }
