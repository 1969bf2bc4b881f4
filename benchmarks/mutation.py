"""Mutation test of what holds the robot, and of what judges: does a test notice when a line is changed?

    python benchmarks/mutation.py                         # 16 changes in each module, drawn with seed 0
    python benchmarks/mutation.py --each 60 --seed 3 --only supervisor,goals
    python benchmarks/mutation.py --each 0 --only alignment     # every change

One change at a time: a comparison turned round, a sign, an operator, `and` for `or`, a number, `min` for
`max`, a condition negated, a statement left out. Texts are left alone, and so are limits that are met exactly
(`<` for `<=`). Each change runs the tests that belong to its module in a process of its own, until one fails;
nothing on disk is altered. Prints what survived. Exit code 1 below `--least` percent.

Written for this project because the well-kept tools do not fit: mutmut and cosmic-ray go through every change
there is, which takes a day here, and cosmic-ray does so in the files that others are reading.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.machinery
import importlib.util
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path

import numba  # noqa: F401  loaded once for all
import numpy as np
import pydantic  # noqa: F401
import pytest
import scipy.optimize  # noqa: F401  loaded once for all

ROOT = Path(__file__).resolve().parents[1]
LONGEST_S, _TIMES = 90.0, 4.0
"""After that, or after so many times what they take unaltered, the tests of a change hang: noticed, too."""
_GUARDS = ("tests/core/test_alignment_and_supervisor.py", "tests/core/test_motion_check.py")
_SENSES = ("tests/core/test_motion_check.py", "tests/core/test_capture_check.py")
_STREAMS = "tests/core/test_stream_watch.py"
_SERVOS = tuple(
    f"tests/servos/test_servo_{name}.py" for name in ("goals", "driver_cycle", "outage", "silence")
)
_RECORDS = ("tests/record/test_record_takes_files.py", "tests/record/test_record_laws.py")
_ACCEPT = "tests/acceptance/test_accept.py"
_COMMISSION = "tests/commission/test_commission.py"
_OF_LOSSES = "delivers or device_does_not or three_times or good_enough or loses_answers or restarts"
_OF_STOPPING = "not_measured or ended or failure or disk or signal or nobody_has_placed"
_OF_CELLS = "cell_fail or supply or measures or sag or sees or noticed or did_nothing or marked"
_QUICK_OF_TILT = "not nothing_changes and not broken_imu"
_QUICK_OF_HOLDING = f"{_QUICK_OF_TILT} and not plant and not five_worlds and not whenever"
MODULES: dict[str, tuple[str, tuple[str, ...]]] = {
    "supervisor": ("hil/loop/supervisor.py", ("tests/core/test_supervisor.py", _GUARDS[0], _SENSES[1])),
    "servo_watch": ("hil/loop/checks/servos.py", ("tests/core/test_servo_watch.py", _GUARDS[0])),
    "crosscheck": ("hil/loop/checks/steering_encoders.py", ("tests/core/test_encoder_crosscheck.py",)),
    "motion_check": ("hil/loop/checks/motion_agreement.py", _SENSES),
    "capture_check": ("hil/loop/checks/mocap_agreement.py", (*_SENSES, "tests/core/test_estimate_watch.py")),
    "estimate_watch": ("hil/loop/checks/mocap_estimate.py", ("tests/core/test_estimate_watch.py",)),
    "pace_watch": ("hil/loop/checks/loop_pause.py", ("tests/core/test_supervisor.py",)),
    "wheel_watch": ("hil/loop/checks/wheel_slip.py", ("tests/core/test_wheel_watch.py",)),
    "doubts": ("hil/loop/checks/cusum.py", _SENSES),
    "agreement": ("hil/loop/checks/disagreement_response.py", ("tests/core/test_supervisor.py", _SENSES[1])),
    "lost_check": ("hil/loop/checks/lost_sensor.py", ("tests/core/test_supervisor.py", _GUARDS[0])),
    "path_check": ("hil/loop/checks/path_error.py", ("tests/core/test_supervisor.py", _GUARDS[0])),
    "left_out": ("hil/loop/checks/exclusion.py", (_SENSES[1], "tests/core/test_supervisor.py")),
    "stream_watch": ("hil/loop/checks/sensor_rate.py", (_STREAMS,)),
    "sample_watch": ("hil/loop/checks/sensor_status.py", ("tests/core/test_sample_watch.py", _STREAMS)),
    "goals": ("hil/drivers/servos/dynamixel/goal_values.py", _SERVOS),
    "outage": ("hil/drivers/servos/dynamixel/answer_timeouts.py", _SERVOS),
    "roll_call": (
        "hil/drivers/servos/dynamixel/late_servos.py",
        ("tests/servos/test_roll_call_by_itself.py", "tests/servos/test_servo_roll_call.py"),
    ),
    "limits": (
        "hil/robot/motion_limits.py",
        ("tests/trajectories/test_trajectories.py", "tests/trajectories/test_many_times_at_once.py"),
    ),
    "alignment": ("hil/loop/alignment.py", (_GUARDS[0],)),
    "poses": ("hil/loop/pose_alignment.py", (_GUARDS[0],)),
    "leaps": ("hil/bench/hold/frame_jumps.py", ("tests/bench/test_frame_jumps.py",)),
    "state_check": ("hil/loop/checks/state_valid.py", ("tests/core/test_state_check.py",)),
    "filter_watch": ("hil/loop/checks/filter_fit.py", ("tests/core/test_filter_watch.py",)),
    "own_parts": ("hil/user_code/checked_calls.py", ("tests/core/test_own_parts.py",)),
    "held": ("hil/bench/hold/held_state.py", ("tests/bench/test_held_in_words.py",)),
    "holding": (
        "hil/bench/hold/hold_check.py",
        (
            "tests/bench/test_tilt_seen.py",
            "tests/bench/test_held_by_whom.py",
            "tests/bench/test_held.py",
            "-k",
            _QUICK_OF_HOLDING,
        ),
    ),
    "tilt": ("hil/bench/hold/tilt_check.py", ("tests/bench/test_tilt_seen.py", "-k", _QUICK_OF_TILT)),
    "losses": (
        "hil/bench/contract/losses.py",
        ("tests/bench/test_contract_at_rest.py", _ACCEPT, "-k", _OF_LOSSES),
    ),
    "pose_at_rest": ("hil/bench/contract/pose_at_rest.py", ("tests/bench/test_contract_at_rest.py",)),
    "fall_watch": ("hil/loop/checks/fall.py", ("tests/core/test_fall_watch.py",)),
    "pressing": ("hil/bench/hold/adhesion_force.py", ("tests/adhesion_bench/test_press_watch.py",)),
    "fault_verdicts": ("hil/fault_matrix/judge.py", ("tests/procedure/test_fault_judge.py", "-k", _OF_CELLS)),
    "measurements": (
        "hil/procedure/measurements.py",
        ("tests/procedure/test_measurements_and_parameters.py", "-k", "not run_small and not one_number"),
    ),
    "looks": ("hil/drivers/doctor_watch.py", ("tests/bench/test_looks.py",)),
    "time_offset": ("hil/datasets/time_offset.py", ("tests/calibration/test_time_offset.py",)),
    "origin": ("hil/config/robot_record/origin.py", _RECORDS),
    "plausible": ("hil/config/robot_record/limits.py", _RECORDS),
    "resting": ("hil/commission/reruns.py", (_COMMISSION, "-k", "rests or part or resumed or many_keys")),
    "stop_words": ("hil/commission/stop_reason.py", (_COMMISSION, "-k", _OF_STOPPING)),
    "alarm": ("hil/console/not_held_alarm.py", ("tests/console/test_alarm.py",)),
    "written": (
        "hil/report/history/removal.py",
        ("tests/report/test_removal.py", "-k", "not command and not terminal"),
    ),
    "coverage": ("hil/datasets/drive_coverage.py", ("tests/calibration/test_coverage_of_a_drive.py",)),
    "copies": (
        "hil/datasets/read.py",
        ("tests/recording/test_names_and_copies.py", "-k", "no_copy or another_clock or packed_and"),
    ),
    "column_units": ("hil/datasets/column_units.py", ("tests/calibration/test_units.py",)),
    "applied": (
        "hil/calibration/applied_warnings.py",
        ("tests/calibration/test_calibration_commands.py", "-k", "fitted or names_no_files or another_model"),
    ),
    "signs": ("hil/datasets/wrong_signs.py", ("tests/calibration/test_wrong_signs.py",)),
    "truth_leaps": ("hil/datasets/truth_jumps.py", ("tests/calibration/test_leaps_of_ground_truth.py",)),
    "caveats": ("hil/calibration/warnings.py", ("tests/calibration/test_caveats.py",)),
    "alike": ("hil/campaign/ineffective_settings.py", ("tests/campaign/test_campaign_alike.py",)),
    "campaign_check": (
        "hil/campaign/plan.py",
        ("tests/campaign/test_campaign_command.py", "-k", "refused_before_anything"),
    ),
    "acceptance": (
        "hil/commission/acceptance.py",
        (_ACCEPT, "-k", "not sheets and not phone and not disk and not listed"),
    ),
}
"""By name: the file, and the tests that belong to it; `-k` picks the quick ones of a file."""
_QUIET = ("-p", "no:faulthandler", "-W", "ignore::pytest.PytestAssertRewriteWarning")
_TURNED = {
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
_COUNT = 100
"""Whole numbers below it are taken for counts: one more is another thing."""
_SWAPPED = {"min": "max", "max": "min", "all": "any", "any": "all"}


@dataclass(frozen=True)
class Change:
    """One altered module: its code, and what was altered where."""

    tree: ast.Module
    line: int
    what: str


class Alter(ast.NodeTransformer):
    """Goes through a module and alters place number `wanted`; counts all places.

    Args:
        wanted: which place; -1 for none.
    """

    def __init__(self, wanted: int = -1) -> None:
        self.wanted, self.count, self.line, self.what = wanted, 0, 0, ""

    def _here(self, node: ast.AST, what: str) -> bool:
        mine = self.count == self.wanted
        if mine:
            self.line, self.what = getattr(node, "lineno", 0), what
        self.count += 1
        return mine

    def _left_alone(self, node: ast.AST) -> ast.AST:
        return node

    visit_JoinedStr = visit_Import = visit_ImportFrom = _left_alone

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        """Its body only: neither annotations nor decorators nor the docstring."""
        node.body = [self.visit(part) for part in node.body]
        node.args.kw_defaults = [d if d is None else self.visit(d) for d in node.args.kw_defaults]
        node.args.defaults = [self.visit(d) for d in node.args.defaults]
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        """As `visit_FunctionDef`."""
        node.body = [self.visit(part) for part in node.body]
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        """Its value only."""
        node.value = None if node.value is None else self.visit(node.value)
        return node

    def visit_keyword(self, node: ast.keyword) -> ast.AST:
        """`strict` and `slots` change nothing that a test could see."""
        return node if node.arg in ("strict", "slots", "frozen") else self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        """One of its comparisons turned round."""
        self.generic_visit(node)
        for k, operator in enumerate(node.ops):
            if type(operator) in _TURNED and self._here(node, ast.unparse(node)):
                node.ops[k] = _TURNED[type(operator)]()
        return node

    def _operator(self, node: ast.BinOp | ast.AugAssign | ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        if type(node.op) in _TURNED and self._here(node, ast.unparse(node)):
            node.op = _TURNED[type(node.op)]()
        return node

    visit_BinOp = visit_AugAssign = visit_BoolOp = _operator

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        """Left out."""
        self.generic_visit(node)
        return node.operand if self._here(node, ast.unparse(node)) else node

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        """A number that is another one, or a truth turned round."""
        if isinstance(node.value, bool):
            if self._here(node, str(node.value)):
                return ast.copy_location(ast.Constant(not node.value), node)
        elif isinstance(node.value, int | float) and self._here(node, str(node.value)):
            fine = isinstance(node.value, int) and abs(node.value) < _COUNT
            more = node.value + 1 if fine or not node.value else 2 * node.value
            return ast.copy_location(ast.Constant(more), node)
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        """`min` for `max`, `all` for `any`, and `abs` left out."""
        self.generic_visit(node)
        if isinstance(node.func, ast.Name):
            if node.func.id in _SWAPPED and self._here(node, ast.unparse(node)):
                node.func.id = _SWAPPED[node.func.id]
            elif node.func.id == "abs" and self._here(node, ast.unparse(node)):
                return node.args[0]
        return node

    def visit_If(self, node: ast.If) -> ast.AST:
        """Its condition negated."""
        self.generic_visit(node)
        if not isinstance(node.test, ast.Compare) and self._here(node, f"if {ast.unparse(node.test)}"):
            node.test = ast.UnaryOp(ast.Not(), node.test)
        return node

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        """A call whose value is not used, left out; never a docstring."""
        if isinstance(node.value, ast.Constant):
            return node
        self.generic_visit(node)
        return ast.copy_location(ast.Pass(), node) if self._here(node, ast.unparse(node)) else node

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        """Left out."""
        return ast.copy_location(ast.Pass(), node) if self._here(node, ast.unparse(node)[:60]) else node


def changes(source: str, each: int, rng: np.random.Generator) -> Iterator[Change]:
    """Some of all changes of a module, in the order of its lines; all of them where `each` is 0."""
    tree = ast.parse(source)
    counted = Alter()
    counted.visit(deepcopy(tree))
    places = np.arange(counted.count)
    if 0 < each < counted.count:
        places = np.sort(rng.choice(places, each, replace=False))
    for place in places.tolist():
        alter = Alter(place)
        changed = ast.fix_missing_locations(alter.visit(deepcopy(tree)))
        yield Change(changed, alter.line, alter.what)


class _Altered(importlib.machinery.SourceFileLoader):
    """Loads a module from a tree instead of its file."""

    def __init__(self, name: str, path: str, tree: ast.Module) -> None:
        super().__init__(name, path)
        self._tree = tree

    def get_code(self, fullname: str):  # type: ignore[no-untyped-def]
        return compile(self._tree, self.path, "exec")


class _Finder:
    """Finds one module, altered."""

    def __init__(self, name: str, path: Path, tree: ast.Module) -> None:
        self._name, self._path, self._tree = name, str(path), tree

    def find_spec(self, name: str, path: object = None, target: object = None):  # type: ignore[no-untyped-def]
        if name != self._name:
            return None
        loader = _Altered(name, self._path, self._tree)
        return importlib.util.spec_from_file_location(name, self._path, loader=loader)


def _tested(name: str, path: Path, tree: ast.Module, tests: Sequence[str]) -> int:
    """Exit code of the tests with the module altered, in this process."""
    sys.meta_path.insert(0, _Finder(name, path, tree))  # type: ignore[arg-type]
    importlib.import_module(name)  # before pytest, whose own loader would take the file
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
        return int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *_QUIET, *tests]))


def survives(
    name: str, path: Path, tree: ast.Module, tests: Sequence[str], longest_s: float = LONGEST_S
) -> bool:
    """Whether all tests pass with the module altered, within a time in s."""
    child = os.fork()
    if not child:
        os.setsid()
        try:
            code = _tested(name, path, tree, tests)
        except BaseException:
            code = 3
        os._exit(code)
    end_s = time.monotonic() + longest_s
    while time.monotonic() < end_s:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status) == 0
        time.sleep(0.05)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


def main() -> None:
    """Alter, test, and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--each", type=int, default=16, help="changes in each module; 0: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default=",".join(MODULES), help="modules, by commas")
    parser.add_argument("--least", type=float, default=90.0, help="percent that must be noticed")
    options = parser.parse_args()
    os.chdir(ROOT)
    total = noticed = 0
    for short in options.only.split(","):
        file, tests = MODULES[short]
        path, name = ROOT / file, file.removesuffix(".py").replace("/", ".")
        source = path.read_text(encoding="utf-8")
        began_s = time.monotonic()
        if not survives(name, path, ast.parse(source), tests, 10.0 * LONGEST_S):
            sys.exit(f"{short}: its tests fail as it is: {' '.join(tests)}")
        longest_s = max(LONGEST_S, _TIMES * (time.monotonic() - began_s))
        rng, survivors, count = np.random.default_rng([options.seed, len(source)]), [], 0
        for change in changes(source, options.each, rng):
            count += 1
            if survives(name, path, change.tree, tests, longest_s):
                survivors.append(change)
        total, noticed = total + count, noticed + count - len(survivors)
        print(f"{short:14s} {count - len(survivors):4d} of {count:4d} noticed", flush=True)
        for change in survivors:
            print(f"    {file}:{change.line}: {' '.join(change.what.split())[:90]}", flush=True)
    share = 100.0 * noticed / max(total, 1)
    print(f"{'all':14s} {noticed:4d} of {total:4d} noticed: {share:.1f} %")
    sys.exit(0 if share >= options.least else 1)


if __name__ == "__main__":
    main()
