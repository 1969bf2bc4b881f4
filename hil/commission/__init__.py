"""Commissioning: procedures from a new robot to a verified run on its wall; each uses the earlier results."""

from hil.commission.run import Commission, commission

__all__ = ["Commission", "commission"]
