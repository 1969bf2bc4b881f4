"""Table and figures of a latency run: delays from command to sample in the loop, and the signals."""

from collections.abc import Callable, Mapping

import numpy as np

from hil.core.geometry import Array
from hil.procedure import Context
from hil.procedures.latency.fit import Delay
from hil.report.plot_style import PALETTE, SERIES, legend, new_figure, style

_SHOWN_S = 3.0

Aged = Mapping[str, tuple[Delay, float]]


def table(ctx: Context, signals: Aged) -> None:
    """Add a table with delay, age and gain of every signal."""
    rows = [
        [
            name,
            f"{1e3 * d.delay_s:+.2f}",
            f"± {1e3 * d.uncertainty_s:.2f}",
            f"{1e3 * age:.2f}",
            f"{1e3 * (d.delay_s + age):.1f}",
            f"{d.gain:.3f}",
            f"{d.misfit:.3f}",
        ]
        for name, (d, age) in signals.items()
    ]
    ctx.table(
        "Delays behind the command",
        ["signal", "by stamps", "95 %", "age", "known after", "size", "misfit"],
        rows,
        "ms; by stamps: mean delay of the response; age: median time to arrival; size: over the command's.",
    )


def draw_chain(ctx: Context, signals: Aged) -> None:
    """Draw per signal the time until the motion was measured, by stamps, and until it was in the loop."""
    figure = new_figure(5.2, 0.74 + 0.4 * len(signals))
    axes = style(figure.add_subplot(), "time after the command (ms)", "")
    for row, (delay, age) in enumerate(signals.values()):
        happened, known = 1e3 * delay.delay_s, 1e3 * (delay.delay_s + age)
        first = row == 0
        axes.barh(row, happened, 0.5, color=SERIES[0], label="until measured, by stamps" if first else None)
        label = "until known" if first else None
        axes.barh(row, known - happened, 0.5, left=happened, color=SERIES[1], label=label)
        axes.errorbar(
            happened, row, xerr=1e3 * delay.uncertainty_s, color=PALETTE["truth"], lw=1.0, capsize=2
        )
        axes.annotate(f" {known:.0f}", (max(known, happened), row), va="center", fontsize=8)
    axes.set_yticks(range(len(signals)), list(signals))
    axes.invert_yaxis()
    axes.margins(x=0.08)
    axes.legend(fontsize=8, frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    ctx.figure(figure, "From command to knowledge", "Marks: 95 % intervals of the delay by stamps.")


def draw_signals(
    ctx: Context,
    command: Callable[[Array], Array],
    signals: Mapping[str, tuple[Array, Array, Delay]],
    title: str,
    label: str,
    factor: float,
) -> None:
    """Draw the first seconds of command and signals, scaled to one size, without offset and drift."""
    figure = new_figure(5.2, 2.8)
    axes = style(figure.add_subplot(), "time (s)", label)
    t = np.linspace(0.0, _SHOWN_S, 600)
    axes.plot(t, factor * command(t), color=PALETTE["truth"], lw=1.8, label="command")
    for colour, (name, (t_s, path, delay)) in zip(SERIES, signals.items(), strict=False):
        if not np.isfinite(delay.gain) or abs(delay.gain) < 1e-6:
            continue
        scaled = path / delay.gain
        trend = np.polyfit(t_s, scaled - command(t_s - delay.delay_s), 1)
        early = t_s < _SHOWN_S
        level = (scaled - np.polyval(trend, t_s))[early]
        axes.plot(t_s[early], factor * level, color=colour, lw=1.1, label=name)
    legend(axes)
    ctx.figure(
        figure,
        title,
        "All signals scaled to one size, without offset and drift. The remaining shift is delay.",
    )
