"""Make a bag of colour images of 1920 x 1200, and print what memory its inspection and its import need at most [MiB].

python -m tests.imports.bag_memory bag.mcap 10    makes a bag of 10 GB, map.toml and bag.rrd
"""

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer

from deformscope.recording.export.mcap import definition
from tests.imports.test_importing import MEMORY

SIZE_PX, HZ = (1200, 1920), 30
START_NS = 10**18


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag", type=Path)
    parser.add_argument("gigabytes", type=float)
    given = parser.parse_args()
    made, map_file = write_images(given.bag, given.gigabytes), given.bag.with_name("map.toml")
    print(f"{made}: {made.stat().st_size / 1e9:.2f} GB")
    map_file.write_text(measured("--inspect", str(made)))
    measured(str(made), "--map", str(map_file), "--record", str(made.with_suffix(".rrd")))


def write_images(path: Path, gigabytes: float) -> Path:
    """Plain colours with noise, as a camera's, that move from image to image."""
    rows, columns = SIZE_PX
    plain = np.add.outer(np.arange(rows), np.arange(columns))[..., None] // (8, 12, 16)
    image = (plain + np.random.default_rng(0).integers(0, 4, (rows, columns, 3))).astype(np.uint8)
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        kind = writer.register_msgdef("sensor_msgs/msg/Image", definition("sensor_msgs/Image"))
        for at in range(round(1e9 * gigabytes / image.nbytes)):
            ns = START_NS + at * 10**9 // HZ
            header = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": "camera"}
            about = {"height": rows, "width": columns, "encoding": "rgb8", "is_bigendian": 0, "step": 3 * columns}
            data = np.roll(image, 16 * at, axis=1).tobytes()
            writer.write_message("/camera", kind, {"header": header, **about, "data": data}, ns, ns, at)
        writer.finish()
    return path


def measured(*asked: str) -> str:
    """What `deformscope import` writes to stdout; its peak of memory is printed."""
    done = subprocess.run([sys.executable, "-c", MEMORY, *asked], capture_output=True, text=True, check=True)
    *said, used = done.stdout.splitlines()
    print(f"deformscope import {' '.join(asked)}: {float(used):.0f} MiB", flush=True)
    return "\n".join(said)


if __name__ == "__main__":
    main()
