"""Another user of this machine, who takes every port that the command line of a rerun that this process started names.

with taking_ports() as taken: ...   # taken(): the ports that this user has
It answers whoever asks there. Needs root, to become that user.
"""

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

NOBODY = 65534
FOREIGN = b"foreign"
TAKE = """
import os, re, selectors, socket, sys
user, attacked = map(int, sys.argv[1:])
os.setgroups([]); os.setgid(user); os.setuid(user)
held, asked = set(), selectors.DefaultSelector()
print("ready", flush=True)
while True:
    for process in filter(str.isdigit, os.listdir("/proc")):
        try:
            words = open(f"/proc/{process}/cmdline", "rb").read().split(b"\\0")
            parent = int(open(f"/proc/{process}/stat").read().rpartition(")")[2].split()[1])
        except OSError:
            continue
        if parent != attacked or not words[0].endswith(b"rerun"):
            continue
        for port in {int(word) for word in words if re.fullmatch(rb"\\d{1,5}", word)} - held - {0}:
            try:
                asked.register(socket.create_server(("127.0.0.1", port)), selectors.EVENT_READ)
            except (OSError, OverflowError):
                continue
            held.add(port)
            print(port, flush=True)
    for key, _ in asked.select(0):
        with key.fileobj.accept()[0] as asking:
            asking.settimeout(0.1)
            try:
                asking.recv(1000)
                asking.sendall(b"HTTP/1.0 200 OK\\r\\n\\r\\nforeign")
            except OSError:
                pass
"""


@contextmanager
def taking_ports() -> Iterator[Callable[[], list[int]]]:
    if os.getuid() != 0:
        pytest.skip("root alone becomes another user")
    command = [sys.executable, "-c", TAKE, str(NOBODY), str(os.getpid())]
    taken = list[int]()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        reading = threading.Thread(target=lambda: taken.extend(map(int, process.stdout or [])))
        reading.start()
        try:
            yield lambda: list(taken)
        finally:
            process.kill()
            reading.join()
