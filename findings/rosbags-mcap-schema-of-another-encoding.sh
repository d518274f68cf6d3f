#!/usr/bin/env bash
# rosbags 0.11.9 reads nothing from an MCAP file, and raises a bare KeyError, if one channel beside those of ROS 2 has a
# schema in JSON Schema, Protobuf or FlatBuffers, even if that channel has no message. MCAP's registry lists these
# encodings, profile `ros2` forbids none of them, and `mcap` reads the file.
# Guess before: the channel of ROS 2 is read, the other is left out. Seen, 2026-11-29, Python 3.11:
#   none 3 by mcap, 3 by rosbags
#   jsonschema 3 by mcap, KeyError 'jsonschema'; protobuf and flatbuffer likewise
# Fails when that changes. Writes into a temporary folder only.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" --quiet --disable-pip-version-check install rosbags==0.11.9 mcap==1.6.0
cat > "$folder/read.py" <<'PY'
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

store, name = get_typestore(Stores.ROS2_HUMBLE), "std_msgs/msg/Float64"
for other in ("none", "jsonschema", "protobuf", "flatbuffer"):
    path = Path(sys.argv[1]) / f"{other}.mcap"
    with path.open("wb") as file:
        out = Writer(file)
        out.start(profile="ros2")
        text = store.generate_msgdef(name, ros_version=2)[0].encode()
        load = out.register_channel("/load", "cdr", out.register_schema(name, "ros2msg", text))
        if other != "none":
            out.register_channel("/notes", "json", out.register_schema("Note", other, b"{}"))
        for at in range(3):
            out.add_message(load, at, bytes(store.serialize_cdr(store.types[name](data=float(at)), name)), at)
        out.finish()
    with path.open("rb") as file:
        by_mcap = sum(1 for _ in make_reader(file).iter_messages())
    try:
        with AnyReader([path]) as bag:
            by_rosbags = f"{sum(1 for _ in bag.messages())} by rosbags"
    except KeyError as error:
        by_rosbags = f"KeyError {error}"
    print(f"{other} {by_mcap} by mcap, {by_rosbags}")
PY
"$folder/venv/bin/python" "$folder/read.py" "$folder" | tee "$folder/said"
{ echo "none 3 by mcap, 3 by rosbags"; printf "%s 3 by mcap, KeyError '%s'\n" jsonschema{,} protobuf{,} flatbuffer{,}; } |
    cmp -s - "$folder/said" || { echo "changed" >&2; exit 1; }
