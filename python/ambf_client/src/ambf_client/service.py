"""A connection to a ROS service that stays open, and never waits longer than it is told to.

rospy's own has no time-out: it would hang with a simulator that hangs.
"""

from __future__ import annotations

import io
import socket
import struct
from typing import Any, Dict, Optional
from urllib.parse import urlparse

import rosgraph
import rospy

from .errors import SimulatorNotFound, SimulatorTimeout, StepRefused


class ServiceConnection:
    """Asks one service, again and again. A request that fails is never sent twice: it may have been carried out."""

    def __init__(self, name: str, kind: Any) -> None:
        """`name` of the service; `kind`: its generated class."""
        self._name = name
        self._kind = kind
        self._socket: Optional[socket.socket] = None
        self._buffer = io.BytesIO()

    def close(self) -> None:
        """Ends the connection; the next call opens another."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def call(self, request: Any, timeout: float) -> Any:
        """The answer to `request`.

        Raises SimulatorNotFound if the service is not there, SimulatorTimeout if no answer comes within `timeout` s or the
        connection breaks, StepRefused if the service cannot read the request.
        """
        if self._socket is None:
            self._socket = self._connect(timeout)
        try:
            self._socket.settimeout(timeout)
            self._buffer.seek(0)
            self._buffer.truncate()
            # Room for the length.
            self._buffer.write(bytes(4))
            request.serialize(self._buffer)
            data = self._buffer.getbuffer()
            struct.pack_into("<I", data, 0, len(data) - 4)
            self._socket.sendall(data)
            del data
            understood = self._read(1)
            (length,) = struct.unpack("<I", self._read(4))
            body = self._read(length)
        except OSError as error:
            self.close()
            raise SimulatorTimeout(f"{self._name}: no answer ({error}); has the simulator ended?") from error
        if understood == b"\0":
            self.close()
            raise StepRefused(f"{self._name}: {body.decode(errors='replace')}")
        return self._kind._response_class().deserialize(body)

    def _connect(self, timeout: float) -> socket.socket:
        try:
            uri = rosgraph.Master(rospy.get_name()).lookupService(self._name)
        except (OSError, rosgraph.MasterException) as error:
            raise SimulatorNotFound(f"there is no service {self._name}: {error}") from error
        address = urlparse(uri)
        try:
            line = socket.create_connection((address.hostname, address.port), timeout)
        except OSError as error:
            raise SimulatorNotFound(f"{self._name} is registered at {uri}, but nobody answers: {error}") from error
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        fields = {
            "callerid": rospy.get_name(),
            "service": self._name,
            "type": self._kind._type,
            "md5sum": self._kind._md5sum,
            "persistent": "1",
        }
        self._socket = line
        try:
            line.sendall(_block(b"".join(_block(f"{key}={value}".encode()) for key, value in fields.items())))
            (length,) = struct.unpack("<I", self._read(4))
            answer = _fields(self._read(length))
        except OSError as error:
            self.close()
            raise SimulatorTimeout(f"{self._name}: no answer ({error})") from error
        if "error" in answer:
            self.close()
            raise StepRefused(f"{self._name}: {answer['error']}")
        return line

    def _read(self, length: int) -> bytes:
        assert self._socket is not None
        data = bytearray()
        while len(data) < length:
            part = self._socket.recv(length - len(data))
            if not part:
                raise OSError("the connection was closed")
            data += part
        return bytes(data)


def _block(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def _fields(header: bytes) -> Dict[str, str]:
    fields: Dict[str, str] = {}
    while len(header) >= 4:
        (length,) = struct.unpack_from("<I", header)
        key, _, value = header[4 : 4 + length].decode(errors="replace").partition("=")
        fields[key] = value
        header = header[4 + length :]
    return fields
