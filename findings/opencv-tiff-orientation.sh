#!/usr/bin/env bash
# OpenCV 5.0.0 turns a TIFF image by its orientation tag also with IMREAD_IGNORE_ORIENTATION and IMREAD_UNCHANGED, which
# the documentation says leave it as stored; a JPEG with the same tag is left as stored by both. So pixels of frames of
# one camera, whose software writes the tag as the camera is held, change places although the flag was given.
# Guess before: (4, 6) for each flag. Seen, 2026-11-29, Python 3.11, an image of 4 rows and 6 columns with orientation 6:
#   tiff ignore (6, 4)    tiff unchanged (6, 4)    jpeg ignore (4, 6)    jpeg unchanged (4, 6)
# Fails when that changes. Writes into a temporary folder only.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" --quiet --disable-pip-version-check install opencv-python-headless==5.0.0.93 numpy==2.4.6
cat > "$folder/read.py" <<'PY'
import struct

import cv2
import numpy as np

HIGH, WIDE, TURNED = 4, 6, 6
image = np.arange(HIGH * WIDE, dtype=np.uint8).reshape(HIGH, WIDE)
tags = {256: WIDE, 257: HIGH, 258: 8, 259: 1, 262: 1, 273: 8, 274: TURNED, 277: 1, 278: HIGH, 279: image.size}
entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
tiff = struct.pack("<2sHI", b"II", 42, 8 + image.size) + image.tobytes()
tiff += struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0)
exif = b"Exif\0\0" + struct.pack("<2sHIHHHII", b"II", 42, 8, 1, 274, 3, 1, TURNED) + struct.pack("<I", 0)
jpeg = cv2.imencode(".jpg", image)[1].tobytes()
jpeg = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]
flags = {"ignore": cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION, "unchanged": cv2.IMREAD_UNCHANGED}
for form, data in (("tiff", tiff), ("jpeg", jpeg)):
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE).shape == (WIDE, HIGH)
    for name, flag in flags.items():
        print(form, name, cv2.imdecode(np.frombuffer(data, np.uint8), flag).shape)
PY
"$folder/venv/bin/python" "$folder/read.py" | tee "$folder/said"
printf '%s\n' "tiff ignore (6, 4)" "tiff unchanged (6, 4)" "jpeg ignore (4, 6)" "jpeg unchanged (4, 6)" |
    cmp -s - "$folder/said" || { echo "changed" >&2; exit 1; }
