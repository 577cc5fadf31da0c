"""A subscriber in a few lines, for the things that well-behaved clients never do."""

import socket
import struct
import xmlrpc.client

import harness
import rosgraph


def publisher_address(port, topic):
    """Host and TCP port at which the only publisher of `topic` takes subscribers."""
    master = rosgraph.Master("/raw", f"http://localhost:{port}")
    node = dict(master.getSystemState()[0])[topic][0]
    with xmlrpc.client.ServerProxy(master.lookupNode(node)) as slave:
        code, message, (_, host, tcp_port) = slave.requestTopic("/raw", topic, [["TCPROS"]])
    assert code == 1, message
    return host, tcp_port


def subscribe(address, topic, name, buffer_bytes=None):
    """A socket that the states of `topic` arrive at; the handshake is done."""
    raw = socket.socket()
    if buffer_bytes:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
    raw.settimeout(harness.PATIENCE_S)
    raw.connect(address)
    fields = [f"callerid=/{name}", f"topic={topic}", "type=*", "md5sum=*", "message_definition=", "tcp_nodelay=1"]
    data = b"".join(struct.pack("<I", len(field)) + field.encode() for field in fields)
    raw.sendall(struct.pack("<I", len(data)) + data)
    header = read_block(raw)
    assert b"md5sum=" in header, header
    return raw


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
