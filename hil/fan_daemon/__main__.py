"""Start the daemon's process by `python -m hil.fan_daemon`; see `process`."""

import sys

from hil.fan_daemon.process import main

sys.exit(main())
