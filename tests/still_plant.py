"""A robot that only has a place in time: what a test's plant does beyond that, it says itself."""

import numpy as np

from hil.fakes.body_interface import Plant, PlantState


class StillPlant(Plant):
    """Rests at the origin on a surface of given tilt; nothing may command it.

    `moves` says otherwise where a test wants a motion: fields of `PlantState` by name.
    """

    t_ns = 0

    def __init__(self, tilt_rad=0.0):
        self.tilt_rad = tilt_rad

    def command(self, joint, command):
        raise AssertionError("a measurement commands nothing")

    def advance(self, t_ns):
        self.t_ns = t_ns

    def joints(self):
        return np.zeros(8), np.zeros(8), np.zeros(8)

    def moves(self):
        """What is not at rest now."""
        return {}

    def truth(self):
        position, velocity, current = self.joints()
        rest = {
            "pose_body_in_wall": np.zeros(3),
            "twist_body": np.zeros(3),
            "acceleration_body": np.zeros(2),
            "joint_position_rad": position.copy(),
            "joint_velocity_rad_s": velocity.copy(),
            "joint_current_a": current.copy(),
            "steering_true_rad": np.zeros(4),
            "normal_load_n": np.full(4, 8.0),
            "slip_m_s": np.zeros((4, 2)),
        }
        return PlantState(t_ns=self.t_ns, tilt_rad=self.tilt_rad, fallen=False, **{**rest, **self.moves()})
