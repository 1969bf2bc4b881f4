"""From a robot as delivered to a verified run on its wall: all procedures in order, each using what the others found."""

from hil.procedure.commission.running import Commission, commission

__all__ = ["Commission", "commission"]
