#!/bin/bash
# Ray 2.60.0 (Python 3.11, Linux): ray.init(address="127.0.0.1:PORT") does not join a cluster that listens on 127.0.0.1.
#
# Valid input: a head node with node_ip_address="127.0.0.1", and the address that it prints. Expected: the driver
# connects to 127.0.0.1:PORT. Seen: ray._private.services.resolve_ip_for_localhost puts the machine's other address in its
# place, nothing listens there, and ray.init tries 20 times for some 17 s each (340 s) before it raises ConnectionError.
# _node_ip_address="127.0.0.1" changes nothing. RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0, meant for other systems, does.
#
# Output seen, 2026-11-29, on a machine with the address 192.0.2.2:
#   plain: not joined within 40 s; it asked 192.0.2.2
#   _node_ip_address: not joined within 40 s; it asked 192.0.2.2
#   RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0: joined
# Needs a machine with an address besides the loopback. Exit status: 0 as above, 1 changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q ray==2.60.0
export RAY_USAGE_STATS_ENABLED=0
cat > "$folder/case.py" <<'PY'
import os, re, subprocess, sys
os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # of this process, which makes the cluster
from ray.cluster_utils import Cluster

head = {"num_cpus": 1, "object_store_memory": 100_000_000, "node_ip_address": "127.0.0.1", "include_dashboard": False}
cluster = Cluster(initialize_head=True, head_node_args=head)
shell = {name: value for name, value in os.environ.items() if name != "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"}
cases = {"plain": ("", {}), "_node_ip_address": (", _node_ip_address='127.0.0.1'", {})}
cases["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0"] = ("", {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"})
joined = []
for name, (more, env) in cases.items():
    code = f"import ray; ray.init(address={cluster.address!r}{more})"
    try:
        ran = subprocess.run([sys.executable, "-c", code], env=shell | env, capture_output=True, timeout=40)
        joined.append(ran.returncode == 0)
        print(f"{name}: {'joined' if joined[-1] else ran.stderr.decode()[-300:]}")
    except subprocess.TimeoutExpired as error:
        asked = re.findall(r"GCS at address ([\d.]+)", (error.stderr or b"").decode())
        joined.append(False)
        print(f"{name}: not joined within 40 s; it asked {', '.join(dict.fromkeys(asked))}")
cluster.shutdown()
sys.exit(joined != [False, False, True])
PY
"$folder/venv/bin/python" "$folder/case.py"
