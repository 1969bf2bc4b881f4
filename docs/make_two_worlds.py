"""Writes docs/two-worlds.md: what the own plant and MuJoCo say of the same robot, procedure and seed."""

from __future__ import annotations

import argparse

from two_worlds import results, wall


def main() -> None:
    """Make what is missing in out/two-worlds, then the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    args = parser.parse_args()
    results.fill("wall", wall.keys(args.seeds), wall.drive)


if __name__ == "__main__":
    main()
