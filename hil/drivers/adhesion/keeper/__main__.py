"""`python -m hil.drivers.adhesion.keeper`: see `process`."""

import sys

from hil.drivers.adhesion.keeper.process import main

sys.exit(main())
