"""Have the process that listens at a socket, the first argument, run ``homolog`` with the other arguments."""

import json
import os
import socket
import sys
from pathlib import Path

with socket.socket(socket.AF_UNIX) as server:
    server.connect(sys.argv[1])
    message = json.dumps([sys.argv[2:], str(Path.cwd()), dict(os.environ)])
    socket.send_fds(server, [message.encode()], [1, 2])
    sys.exit(server.recv(1)[0])
