#!/usr/bin/env bash
# Open3D 0.20.0 reads points in float64 of a binary PCD file as 0, without an error or a warning; the same in ASCII, and
# float32 in binary, come as they are. PCD allows 8 bytes for type F.
# Guess before: (1, 2, 3) three times. Seen, 2026-11-29, Python 3.11:
#   binary float32 [1.0, 2.0, 3.0]
#   ascii float64 [1.0, 2.0, 3.0]
#   binary float64 [0.0, 0.0, 0.0]
# Fails when that changes. Writes into a temporary folder only. Needs libGL and libusb, as Open3D does.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" --quiet --disable-pip-version-check install open3d==0.20.0 numpy==2.4.6
cat > "$folder/read.py" <<'PY'
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import open3d

folder = Path(sys.argv[1])
print(f"open3d {version('open3d')}", file=sys.stderr)
for form, size in (("binary", 4), ("ascii", 8), ("binary", 8)):
    each = f"{size} {size} {size}"
    head = f"VERSION .7\nFIELDS x y z\nSIZE {each}\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\n"
    head += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\nDATA {form}\n"
    body = b"1 2 3\n" if form == "ascii" else np.array([1, 2, 3], f"<f{size}").tobytes()
    (folder / "a.pcd").write_bytes(head.encode() + body)
    points = np.asarray(open3d.io.read_point_cloud(str(folder / "a.pcd")).points)
    print(form, f"float{8 * size}", *points.tolist())
PY
"$folder/venv/bin/python" "$folder/read.py" "$folder" | tee "$folder/said"
printf '%s\n' "binary float32 [1.0, 2.0, 3.0]" "ascii float64 [1.0, 2.0, 3.0]" "binary float64 [0.0, 0.0, 0.0]" |
    cmp -s - "$folder/said" || { echo "changed" >&2; exit 1; }
