"""The emulated robot body in MuJoCo, an independent rigid-body engine with its own contact model."""

from hil.fakes.plant.mujoco.contact_settings import CONTACTS, ContactSetting
from hil.fakes.plant.mujoco.from_configuration import make_mujoco_plant
from hil.fakes.plant.mujoco.robot import MujocoRobot

__all__ = ["CONTACTS", "ContactSetting", "MujocoRobot", "make_mujoco_plant"]
