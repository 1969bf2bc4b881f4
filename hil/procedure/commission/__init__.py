"""From a robot as delivered to a verified run on its wall: every procedure uses what the others found."""

from hil.procedure.commission.run import Commission, commission

__all__ = ["Commission", "commission"]
