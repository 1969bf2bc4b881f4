"""Writes docs/two-worlds.md: what the own plant and MuJoCo say of the same robot, procedure and seed."""

from __future__ import annotations

import argparse

from two_worlds import calibration, results, wall


def main() -> None:
    """Make what is missing in out/two-worlds, then the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", choices=["wall", "calibration"], help="make only these figures, no page")
    args = parser.parse_args()
    if args.only != "calibration":
        results.fill("wall", wall.keys(args.seeds), wall.drive)
    if args.only != "wall":
        results.fill("calibration", calibration.keys(args.seeds), calibration.judge)


if __name__ == "__main__":
    main()
