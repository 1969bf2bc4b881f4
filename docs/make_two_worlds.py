"""Writes docs/two-worlds.md: what the own plant and MuJoCo say of the same robot, procedure and seed.

    python docs/make_two_worlds.py --seeds 10

Figures that are there (docs/two_worlds/figures) are kept; take a file away to have it measured again. All of
them take about two hours of processor time. `--only` makes one part of the figures and no page, so that two
may run beside each other; `--only page` writes the page from what is there.
"""

from __future__ import annotations

import argparse

from two_worlds import calibration, oracles, page, procedures, results, wall


def main() -> None:
    """Make what is missing, then the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10, help="worlds on the wall, and robots to calibrate")
    parser.add_argument("--only", choices=["oracles", "procedures", "wall", "calibration", "page"])
    given = parser.parse_args()
    if given.only in (None, "oracles"):
        results.fill("oracles", oracles.keys(), oracles.measure)
    if given.only in (None, "procedures"):
        results.fill("procedures", procedures.keys(), procedures.run)
    if given.only in (None, "wall"):
        results.fill("wall", wall.keys(given.seeds), wall.drive)
    if given.only in (None, "calibration"):
        results.fill("calibration", calibration.keys(given.seeds), calibration.judge)
    if given.only in (None, "page"):
        page.write(*(results.known(name) for name in ("oracles", "procedures", "wall", "calibration")))


if __name__ == "__main__":
    main()
