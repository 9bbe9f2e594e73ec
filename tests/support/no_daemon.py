"""Answers in the place of a daemon by another program: for each side that asks one."""


def http(body: bytes, head: bytes = b"HTTP/1.1 200 OK") -> bytes:
    """An answer of HTTP with this body."""
    return head + b"\r\nContent-Length: %d\r\nConnection: close\r\n\r\n" % len(body) + body


GARBAGE = (
    (b"SSH-2.0-OpenSSH_9.2\r\n", "is not an altd daemon: SSH-2.0-OpenSSH_9.2"),
    (http(b"<html>"), "is not an altd daemon: is not JSON: "),
    (http(b"\xff\xfe"), "is not an altd daemon: is not JSON: "),
    (http(b"[" * 500_000), "is not an altd daemon: is nested too deeply"),
    (http(b'{"verdict": "good"}')[:-4], "is not an altd daemon: "),
    (http(b'{"verdict": "' + b"x" * 2_000_000), "is not an altd daemon: "),
    (b"HTTP/1.1 200 OK\r\n" + b"A: b\r\n" * 1000 + b"\r\n{}", "is not an altd daemon: got more than 100"),
    (b"HTTP/1.1 200 OK\r\nA: " + b"x" * 100_000, "is not an altd daemon: got more than 65536 bytes"),
)
"""Answers with what is said of each."""
