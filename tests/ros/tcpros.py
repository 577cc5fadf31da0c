"""A subscriber in a few lines, for the things that well-behaved clients never do."""

import socket
import struct
import xmlrpc.client

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
    fields = [f"callerid=/{name}", f"topic={topic}", "type=*", "md5sum=*", "message_definition=", "tcp_nodelay=1"]
    data = b"".join(struct.pack("<I", len(field)) + field.encode() for field in fields)
    raw.sendall(struct.pack("<I", len(data)) + data)
    raw.fields = fields_of(read_block(raw))
    assert "md5sum" in raw.fields, raw.fields
    return raw


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
