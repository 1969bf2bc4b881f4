"""The emulated robot body in MuJoCo, an independent rigid-body engine with its own contact model."""

from hil.fakes.mujoco_plant.contact import CONTACTS, ContactSetting
from hil.fakes.mujoco_plant.from_configuration import make_mujoco_plant
from hil.fakes.mujoco_plant.robot import MujocoRobot

__all__ = ["CONTACTS", "ContactSetting", "MujocoRobot", "make_mujoco_plant"]
