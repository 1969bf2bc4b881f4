"""Start the daemon's process by `python -m hil.fan_daemon`; see `process`."""

import sys

sys.modules["asammdf"] = None  # type: ignore[assignment]  # python-can would load pandas with it: 100 MB locked

from hil.fan_daemon.process import main  # noqa: E402

sys.exit(main())
