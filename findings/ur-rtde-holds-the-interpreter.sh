#!/bin/bash
# ur-rtde 1.6.5 (Python 3.11, Linux): RTDEReceiveInterface connects with the interpreter's lock held, and without a time
# limit. A controller that is simulated by a thread of the same Python process never answers, and both hang for ever.
#
# Valid input: a server thread that answers RTDE's first request (protocol version) as the guide has it. Expected: the
# constructor waits as other clients do (socket, select), while the thread answers. Seen: the thread does not run again
# once the constructor has connected; no exception, no timeout. With the server in another process the next request,
# for the controller's version, comes at once.
#
# Output seen, 2026-11-30:
#   server in a thread: no second request within 5 s
#   server in a process: second request: 000376
# Exit status: 0 as above, 1 changed.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q ur-rtde==1.6.5
cat > "$folder/serve.py" <<'PY'
import socket, threading

def serve(listening, heard):
    client, _ = listening.accept()
    client.recv(64)  # 00 05 56 00 02: version 2?
    client.sendall(bytes.fromhex("00045601"))  # accepted
    print(client.recv(64).hex(), file=heard, flush=True)
PY
cat > "$folder/case.py" <<'PY'
import socket, subprocess, sys
code = """
import socket, sys, threading
from serve import serve
listening = socket.create_server(("127.0.0.1", 30004))
if sys.argv[1] == "process":
    print("ready", flush=True)
    serve(listening, sys.stdout)
else:
    import rtde_receive
    threading.Thread(target=serve, args=(listening, sys.stdout), daemon=True).start()
    rtde_receive.RTDEReceiveInterface("127.0.0.1")
"""
seen = []
for where in ("thread", "process"):
    server = subprocess.Popen([sys.executable, "-c", code, where], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    client = None
    if where == "process":
        server.stdout.readline()
        asking = 'import rtde_receive; rtde_receive.RTDEReceiveInterface("127.0.0.1")'
        client = subprocess.Popen([sys.executable, "-c", asking], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        words, _ = server.communicate(timeout=5)
        seen.append(words.decode().strip())
    except subprocess.TimeoutExpired:
        server.kill()
        server.communicate()
        seen.append("")
    if client is not None:
        client.kill()
        client.wait()
    print(f"server in a {where}:", f"second request: {seen[-1]}" if seen[-1] else "no second request within 5 s")
sys.exit(seen != ["", "000376"])
PY
cd "$folder" && "$folder/venv/bin/python" case.py
