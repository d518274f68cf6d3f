"""The simulated sensor, for datagrams; and its page for those who ask for it by HTTP."""

import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

from deformscope_drivers.interface import FloatArray, Scene
from deformscope_netft.config import HexConfig, NetftConfig
from deformscope_netft.protocol import HEADER, RECORD, REQUEST, Command, Record

COUNTS_PER_N, COUNTS_PER_NM = 1_000_000.0, 1_000_000.0
OFFSET = (4.0, -3.0, 12.0, 0.05, -0.1, 0.02)
"""What it shows without a load before it is zeroed [N, N m]."""
NOISE_N, NOISE_NM = 0.01, 2e-4
SAMPLES_HZ = 7000.0


class NetftDouble:
    """A sensor that answers requests. status: status of its records"""

    datagram_bytes = RECORD.size

    def __init__(self, config: NetftConfig | HexConfig, scene: Scene | None = None) -> None:
        self._scene: Scene = scene if scene is not None else lambda time_s: (0.0,) * 6
        per_n, per_nm = config.counts_per_n or COUNTS_PER_N, config.counts_per_nm or COUNTS_PER_NM
        self._per_load = np.array([per_n] * 3 + [per_nm] * 3)
        self._rate_hz, self._is_hex = config.rate_hz, isinstance(config, HexConfig)
        self.status = 0
        self.power_up(0)

    def power_up(self, now_ns: int) -> None:
        """Start as after switching on: it sends nothing, and its bias is that of the factory."""
        self._random = np.random.default_rng(0)
        self._bias: FloatArray = np.zeros(6)
        self._begin_ns, self._next_ns, self._left, self._sequence = now_ns, now_ns, 0, 0
        self._period_ns = round(1e9 / self._rate_hz)
        self.filter = 4

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take one request; others are ignored."""
        if len(data) != REQUEST.size:
            return
        header, command, count = REQUEST.unpack(data)
        if header != HEADER:
            return
        if command == Command.STOP:
            self._left = 0
        elif command == Command.STREAM:
            self._left, self._next_ns, self._sequence = count or 1 << 62, now_ns, 0
        elif command == Command.BIAS:
            takes = count == 255 or not self._is_hex
            self._bias = self._load(now_ns) if takes else np.zeros(6)
        elif command == Command.SPEED and self._is_hex and count:
            self._period_ns = count * 1_000_000
        elif command == Command.FILTER and self._is_hex:
            self.filter = count

    def due(self, now_ns: int) -> bytes:
        """Records that have left by now and were not handed out before."""
        sent = b""
        while self._left and self._next_ns <= now_ns:
            noise = self._random.standard_normal(6) * ([NOISE_N] * 3 + [NOISE_NM] * 3)
            load = self._load(self._next_ns) - self._bias + noise
            counts = np.clip(np.rint(load * self._per_load), -(2**31), 2**31 - 1)
            self._sequence += 1
            samples = round((self._next_ns - self._begin_ns) * 1e-9 * SAMPLES_HZ)
            sent += Record(self._sequence, samples, self.status, tuple(counts.astype(int).tolist())).encode()
            self._next_ns += self._period_ns
            self._left -= 1
        return sent

    def next_ns(self, now_ns: int) -> int | None:
        """When the next record is due; None while it is stopped."""
        return self._next_ns if self._left else None

    def _load(self, now_ns: int) -> FloatArray:
        return np.asarray(self._scene(now_ns * 1e-9), float) + OFFSET


class NetftPage:
    """`with NetftPage() as page: NetftConfig(http_port=page.port)`: the sensor's page on loopback.

    values: content of its tags"""

    def __init__(self, **values: object) -> None:
        self.values: dict[str, object] = {
            "prodname": "ATI Net F/T (simulated)",
            "setserial": "FT00001",
            "cfgcpf": round(COUNTS_PER_N),
            "cfgcpt": round(COUNTS_PER_NM),
            "scfgfu": "N",
            "scfgtu": "N-m",
            "comrdtrate": 1000,
        } | values
        page = self

        class Answers(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200 if self.path == "/netftapi2.xml" else 404)
                self.end_headers()
                self.wfile.write(page.content() if self.path == "/netftapi2.xml" else b"")

            def log_message(self, format: str, *values: Any) -> None:
                """Nothing is written of requests."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Answers)
        self.port = int(self._server.server_address[1])

    def content(self) -> bytes:
        """The page."""
        tags = "".join(f"<{tag}>{value}</{tag}>" for tag, value in self.values.items())
        return f'<?xml version="1.0" encoding="iso-8859-1" ?><netft>{tags}</netft>'.encode()

    def __enter__(self) -> "NetftPage":
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
