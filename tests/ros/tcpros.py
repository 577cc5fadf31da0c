"""A subscriber and a publisher in a few lines, for the things that well-behaved clients never do."""

import contextlib
import socket
import struct
import threading
import xmlrpc.client
import xmlrpc.server

import harness
import rosgraph


class Connection(socket.socket):
    """A socket that knows what the publisher said about itself in `fields`."""

    fields = None


def publisher_address(port, topic):
    """Host and TCP port at which the only publisher of `topic` takes subscribers."""
    master = rosgraph.Master("/raw", f"http://localhost:{port}")
    node = dict(master.getSystemState()[0])[topic][0]
    with xmlrpc.client.ServerProxy(master.lookupNode(node)) as slave:
        code, message, (_, host, tcp_port) = slave.requestTopic("/raw", topic, [["TCPROS"]])
    assert code == 1, message
    return host, tcp_port


def subscribe(address, topic, name, buffer_bytes=None):
    """A connection at which the states of `topic` arrive; the handshake is done."""
    raw = Connection()
    if buffer_bytes:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
    raw.settimeout(harness.PATIENCE_S)
    raw.connect(address)
    anything = {"type": "*", "md5sum": "*", "message_definition": "", "tcp_nodelay": "1"}
    raw.sendall(header_of(callerid=f"/{name}", topic=topic, **anything))
    raw.fields = fields_of(read_block(raw))
    assert "md5sum" in raw.fields, raw.fields
    return raw


class Publisher:
    """A node that publishes `topic`, and does `behave(connection)` with each subscriber in a thread of its own."""

    def __init__(self, port, name, topic, kind, behave, host="127.0.0.1"):
        """`host`: where it says that it is."""
        self.name, self.topic, self._behave = f"/{name}", topic, behave
        # How many subscribers have come so far.
        self.connections = 0
        self._server = socket.create_server(("127.0.0.1", 0))
        self._api = xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        address = ["TCPROS", "127.0.0.1", self._server.getsockname()[1]]
        self._api.register_function(lambda *_: (1, "", address), "requestTopic")
        for work in (self._api.serve_forever, self._accept):
            threading.Thread(target=work, daemon=True).start()
        self._uri = f"http://{host}:{self._api.server_address[1]}/"
        self._master = rosgraph.Master(self.name, f"http://localhost:{port}")
        self._master.registerPublisher(topic, kind, self._uri)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._master.unregisterPublisher(self.topic, self._uri)
        self.die()

    def die(self):
        """Ends without telling the master, as a program that is killed."""
        self._api.shutdown()
        self._api.server_close()
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                raw = self._server.accept()[0]
                self.connections += 1
                threading.Thread(target=self._serve, args=(raw,), daemon=True).start()

    def _serve(self, raw):
        # A subscriber may leave any time.
        with raw, contextlib.suppress(OSError):
            self._behave(raw)


def header_of(**fields):
    """A connection header behind its length."""
    fields = [f"{name}={value}".encode() for name, value in fields.items()]
    return block(b"".join(block(field) for field in fields))


def block(data):
    """`data` behind its length."""
    return struct.pack("<I", len(data)) + data


def fields_of(header):
    """{name: value} of a connection header."""
    fields, at = {}, 0
    while at < len(header):
        (length,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + length].decode().partition("=")
        fields[name], at = value, at + 4 + length
    return fields


def read_block(raw):
    """The next length-prefixed block: the header or a message."""
    (length,) = struct.unpack("<I", read_exactly(raw, 4))
    return read_exactly(raw, length)


def read_exactly(raw, count):
    """So many bytes."""
    data = b""
    while len(data) < count:
        part = raw.recv(count - len(data))
        if not part:
            raise ConnectionError("closed by the publisher")
        data += part
    return data


def unsent_bytes(raw):
    """Bytes that the other side of a local connection has not got rid of yet; None once it has closed it."""
    mine, other = raw.getsockname()[1], raw.getpeername()[1]
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        with open(table, encoding="ascii") as lines:
            for line in list(lines)[1:]:
                _, local, remote, state, queues = line.split()[:5]
                ends = (int(local.split(":")[1], 16), int(remote.split(":")[1], 16))
                # 01: established
                if ends == (other, mine) and state == "01":
                    return int(queues.split(":")[0], 16)
    return None
