"""The emulated robot body in MuJoCo: another rigid-body engine with contacts that others wrote and test."""

from hil.fakes.mujoco_plant.contact import CONTACTS, ContactSetting
from hil.fakes.mujoco_plant.from_configuration import make_mujoco_plant
from hil.fakes.mujoco_plant.robot import MujocoRobot

__all__ = ["CONTACTS", "ContactSetting", "MujocoRobot", "make_mujoco_plant"]
