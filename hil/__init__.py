"""Hardware-in-the-loop bench for a wall-climbing robot with four steered and driven wheels (4WIS4WID)."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hil.bench import Bench, open_bench

__version__ = "1.0.0"
__all__ = ["Bench", "__version__", "open_bench"]


def __getattr__(name: str) -> Any:
    """`hil.open_bench` and `hil.Bench`, imported on first use so that `import hil` stays quick."""
    if name in ("Bench", "open_bench"):
        from hil import bench

        return getattr(bench, name)
    raise AttributeError(f"module 'hil' has no attribute {name!r}")
