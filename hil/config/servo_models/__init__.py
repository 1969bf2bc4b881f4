"""Servo models as data: control table, units, limits and motor of each, by the model number on the bus.

Shared by the driver and by the emulated servo, which have nothing else in common. One TOML file per family;
another model of a family is an entry there, and no file is read before a model is needed.
"""

from hil.config.servo_models.control_table_entry import Register
from hil.config.servo_models.loading import (
    DEFAULT_MODEL,
    model_text,
    models_text,
    servo_model,
    servo_models,
    shared_register,
)
from hil.config.servo_models.model import Motor, Performance, ServoModel

__all__ = [
    "DEFAULT_MODEL",
    "Motor",
    "Performance",
    "Register",
    "ServoModel",
    "model_text",
    "models_text",
    "servo_model",
    "servo_models",
    "shared_register",
]
