#!/usr/bin/env bash
# `rerun rrd compare` of rerun-sdk 0.41.0 finds a recording different from itself once a component of floats in it is NaN.
# Who compares two runs so (with or without --unordered) learns of a difference that is none: NaN stands for what was
# not seen, in positions of lost points or in a sensor's gap.
# Guess before: a file equals itself. Seen, 2026-11-29, Python 3.11:
#   1.0 equal, equal; nan different, different
# Fails when that changes. Writes into a temporary folder only.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
export HOME="$folder"  # its settings
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/pip" --quiet --disable-pip-version-check install rerun-sdk==0.41.0
cat > "$folder/write.py" <<'PY'
import sys

import rerun as rr

path, value = sys.argv[1:]
stream = rr.RecordingStream("comparison")
stream.save(path)
stream.set_time("frame", sequence=0)
stream.log("force", rr.Scalars([float(value)]))
stream.flush()
PY
"$folder/venv/bin/rerun" analytics disable > "$folder/log" 2>&1
for value in 1.0 nan; do
    "$folder/venv/bin/python" "$folder/write.py" "$folder/$value.rrd" "$value" 2> "$folder/log"
    cp "$folder/$value.rrd" "$folder/copy.rrd"
    said=()
    for how in "" --unordered; do
        # shellcheck disable=SC2086
        if "$folder/venv/bin/rerun" rrd compare $how "$folder/$value.rrd" "$folder/copy.rrd" > "$folder/log" 2>&1; then
            said+=(equal)
        else
            said+=(different)
        fi
    done
    echo "$value ${said[0]}, ${said[1]}"
done | tee "$folder/said"
printf '%s\n' '1.0 equal, equal' 'nan different, different' | cmp -s - "$folder/said" || { echo changed >&2; exit 1; }
