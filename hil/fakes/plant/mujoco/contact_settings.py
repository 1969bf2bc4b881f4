"""Contact of wheels and surface in MuJoCo: two settings of its soft contacts, and their random variation.

MuJoCo models friction as a constraint with a regularisation R: a wheel with a force F along the surface
slips with v = F R / b. Two choices of R are useful on a wall:

* `holding`: R so small, followed by MuJoCo's no-slip passes, that a wheel holds until its friction cone is
  reached. That is dry friction.
* `creep`: R in proportion to the rolling speed, so that a loaded wheel loses the same share of every metre at
  any speed, as a tyre does, and holds at rest. MuJoCo has one R for all contacts and directions, so this
  creep is isotropic and grows with the force, while that of the own plant grows with force per load.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

TIME_CONSTANT_S = 0.02
IMPEDANCE = 0.98
"""Impedance of the normal direction. The penetration depth follows from it: less than 0.1 mm for 11 N."""
FRICTION_TIME_CONSTANT_S = 0.004
"""Shortest time that MuJoCo allows at a step of 2 ms: in a curve, a wheel slips sideways by the lateral
acceleration times this."""
DAMPING_PER_S = 2.0 / (IMPEDANCE * FRICTION_TIME_CONSTANT_S)
HOLDING_IMPRATIO = 100.0
CREEP_FLOOR_M_S = 2e-5
"""Rolling speed below which R stays constant: the drift of a robot at rest is this share of its creep."""


@dataclass(frozen=True)
class ContactSetting:
    """Contact parameters of one setting.

    Attributes:
        creep_per_n: share of its travel that a wheel loses per N along the surface; 0 for no creep.
        noslip_passes: iterations of MuJoCo's post-processing that removes the slip caused by R.
    """

    creep_per_n: float
    noslip_passes: int

    def drawn(self, rng: np.random.Generator) -> ContactSetting:
        """Draw the contact of one robot: the creep of tyres varies by 10 %."""
        return replace(self, creep_per_n=self.creep_per_n * float(rng.uniform(0.9, 1.1)))

    def ratio_times_speed(self, normal_r: float) -> float:
        """`impratio` times rolling speed, m/s, for this creep with a contact's R; 0 without creep."""
        return 0.0 if self.creep_per_n == 0.0 else normal_r / (self.creep_per_n * DAMPING_PER_S)


CONTACTS = {
    "creep": ContactSetting(creep_per_n=0.016, noslip_passes=0),
    "holding": ContactSetting(creep_per_n=0.0, noslip_passes=5),
}
