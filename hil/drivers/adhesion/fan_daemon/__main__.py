"""Start the daemon's process by `python -m hil.drivers.adhesion.fan_daemon`; see `process`."""

import sys

from hil.drivers.adhesion.fan_daemon.process import main

sys.exit(main())
