"""`python -m hil` is the same as `hil`."""

from hil.cli import script

if __name__ == "__main__":
    script()
