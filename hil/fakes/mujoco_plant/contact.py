"""Contact of wheels and surface in MuJoCo: two settings of its soft contacts, and their random draw.

Friction there is a constraint with a regularisation R: a wheel that bears a force F along the surface gives
way with v = F R / b. Two choices of R are of use on a wall:

* `holding`: R so small, and MuJoCo's no-slip passes behind it, that a wheel holds until its friction cone is
  reached. That is dry friction.
* `creep`: R in proportion to how fast the wheels roll, so that a loaded wheel loses the same share of every
  metre at any speed, as a tyre does, and holds at rest. MuJoCo has one R for all contacts and directions:
  this creep is isotropic and grows with the force, not with force by load as that of the own plant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

TIME_CONSTANT_S = 0.02
IMPEDANCE = 0.98
"""Of the normal direction: how deep a wheel sinks in follows; 11 N press it in by less than 0.1 mm."""
FRICTION_TIME_CONSTANT_S = 0.004
"""The shortest that MuJoCo takes at a step of 2 ms: a wheel on a bend slides out by the bend's acceleration
times this."""
DAMPING_PER_S = 2.0 / (IMPEDANCE * FRICTION_TIME_CONSTANT_S)
HOLDING_IMPRATIO = 100.0
CREEP_FLOOR_M_S = 2e-5
"""Rolling speed below which R stays: what a robot at rest drifts by is this share of what it creeps."""


@dataclass(frozen=True)
class ContactSetting:
    """One way of touching.

    Attributes:
        creep_per_n: share of the way that a wheel loses per N along the surface; 0 holds.
        noslip_passes: of MuJoCo's post-processing that takes the slip out which R leaves.
    """

    creep_per_n: float
    noslip_passes: int

    def drawn(self, rng: np.random.Generator) -> ContactSetting:
        """Draw the contact of one robot: tyres differ by a tenth."""
        return replace(self, creep_per_n=self.creep_per_n * float(rng.uniform(0.9, 1.1)))

    def ratio_times_speed(self, normal_r: float) -> float:
        """`impratio` times rolling speed, m/s, that gives this creep with a contact's R; 0 where it holds."""
        return 0.0 if self.creep_per_n == 0.0 else normal_r / (self.creep_per_n * DAMPING_PER_S)


CONTACTS = {
    "creep": ContactSetting(creep_per_n=0.016, noslip_passes=0),
    "holding": ContactSetting(creep_per_n=0.0, noslip_passes=5),
}
