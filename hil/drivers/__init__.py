"""Drivers: what speaks to a device. `KIND/kind.py` is what a kind is, `KIND/MODEL/` a product of that kind.

A model's folder has `model.py` (its names, its table, how it is found and looked at) and `driver.py`, and
`messages.py` where it has a protocol of its own. The emulated device of the same model stands in `hil.fakes`,
under the same path.
"""
