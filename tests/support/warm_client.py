"""What a test starts in place of `python` (see warm_start): asks for a fork, passes signals on, ends as it ends.

python -IS warm_client.py SOCKET WORDS ...
"""

import json
import os
import signal
import socket
import sys

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1)


def main() -> int:
    """The exit code of the program."""
    path, *words = sys.argv[1:]
    server = socket.socket(socket.AF_UNIX)
    server.connect(path)
    asked = {"words": words, "folder": os.getcwd(), "environment": dict(os.environ)}
    text = json.dumps(asked).encode()
    socket.send_fds(server, [len(text).to_bytes(8, "big")], [0, 1, 2])
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # none is lost before there is a program
    server.sendall(text)
    answers = server.makefile()
    program = int(answers.readline())
    for number in SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda number, frame: os.kill(program, number))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    for stream in (0, 1, 2):
        os.close(stream)  # who reads the output waits for the program's end of it only
    code = int(answers.readline())
    if code < 0:
        signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    return code


if __name__ == "__main__":
    os._exit(main())
