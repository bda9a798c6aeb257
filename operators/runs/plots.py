"""Plots of `crowd-lod report error`. Only this file needs matplotlib."""

from itertools import groupby
from pathlib import Path
from textwrap import fill

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ...crowd_lod.validation.error_vs_runtime import LEVEL_OFFSETS

PLOT_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
MARKERS = "osD^v<>"


def draw_plots(folder: Path, tables: dict[str, list[dict]], caption: str) -> None:
    """Write error_behavior.png, error_culling.png and error_levels.png to `folder`."""
    figure = _figure("Behavior: distance from the exact way", caption)
    _behavior(figure.add_subplot(1, 2, 1), tables["behavior"])
    _drift(figure.add_subplot(1, 2, 2), tables["drift"])
    _save(figure, folder / "error_behavior.png")
    figure = _figure("Culling: agents a frame that differ from the exact six planes", caption)
    for place, what in enumerate(("missed", "surplus")):
        _culling(figure.add_subplot(1, 2, place + 1), tables["culling"], what, legend=place == 1)
    _save(figure, folder / "error_culling.png")
    figure = _figure("LOD assignment: difference from exact arithmetic", caption)
    _distances(figure.add_subplot(1, 2, 1), tables["levels"])
    _ids(figure.add_subplot(1, 2, 2), tables["levels"])
    _save(figure, folder / "error_levels.png")


def _figure(title: str, caption: str) -> Figure:
    figure = Figure(figsize=(12, 8), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    figure.text(0.5, 0.985, title, fontsize=14, ha="center", va="top")
    figure.text(0.5, 0.945, fill(caption, 170), fontsize=8, color="#444444", ha="center", va="top")
    figure.get_layout_engine().set(rect=(0, 0, 1, 0.93))
    return figure


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, pil_kwargs={"optimize": True})


def _axes(axes, floor: float, x: str, y: str) -> None:
    """Set log axes with labels, and mark `floor` as the line where zeros are drawn."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.axhline(floor, color="#999999", lw=0.8, ls=":")
    axes.text(0.01, floor, "0 (none)", transform=axes.get_yaxis_transform(), va="bottom", fontsize=8, color="#666666")
    axes.set(xlabel=x, ylabel=y)
    axes.margins(x=0.12, y=0.08)
    low, high = axes.dataLim.intervaly
    if high < 100 * low:  # everything lies on the floor, or near it
        axes.set_autoscaley_on(False)  # which complains where all is the same
        axes.set_ylim(floor / 3, 1000 * floor)
    axes.grid(alpha=0.25, which="major")


def _points(axes, rows: list[dict], value, floor: float, **style) -> None:
    """Plot value(row) against milliseconds, with their range as bars."""
    ms = [r["ms"] for r in rows]
    spread = [[r["ms"] - r["ms_least"] for r in rows], [r["ms_most"] - r["ms"] for r in rows]]
    y = [max(value(r), floor) for r in rows]
    axes.errorbar(ms, y, xerr=spread, capsize=2, elinewidth=0.8, ms=5, lw=1.2, **style)


def _star(axes, row: dict, value, floor: float) -> None:
    axes.plot(row["ms"], max(value(row), floor), "*", ms=18, mfc="none", mec="black", mew=1.4, zorder=9, label="default")


def _shared_legend(axes) -> None:
    """Draw one legend under both plots of the figure."""
    axes.figure.legend(*axes.get_legend_handles_labels(), fontsize=8, loc="outside lower center", ncols=4, frameon=False)


def _legend(axes) -> None:
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2, frameon=False)


def _behavior(axes, rows: list[dict]) -> None:
    floor = 1e-17
    for color, (name, found) in zip(PLOT_COLORS, groupby(rows, lambda r: r["method"]), strict=False):
        found = list(found)
        order = found[0]["order"]
        if name == "exact walk":
            says = "in one go"
        elif found[-1]["apart"] > 0.001:
            says = f"order {order:.2f}, does not converge: {found[-1]['apart']:.1%} of agents end over a cell away"
        else:
            says = "exact up to rounding" if order != order else f"order {order:.2f}"
        for k, (what, line) in enumerate((("mean", "-"), ("median", "--"), ("worst", ":"))):
            label = f"{name}, mean ({says})" if k == 0 else f"{name}, {what}"
            if name == "exact walk":
                label, what = f"{name} ({says})", "mean"
            style = {"color": color, "ls": line, "marker": MARKERS[k]}
            _points(axes, found, lambda r, w=what: r[f"{w}_m"], floor, label=label, **style)
            if name == "exact walk":
                break
    for row in rows:
        if row["default"]:
            _star(axes, row, lambda r: r["mean_m"], floor)
    dts = [r["dt_s"] for r in rows if r["dt_s"]]
    _axes(
        axes,
        floor,
        "ms per second of scene (bars: least to most)",
        f"error, m  (dt from {max(dts):.3g} s to {min(dts):.2g} s, left to right)",
    )
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=1, frameon=False)


def _drift(axes, rows: list[dict]) -> None:
    key = lambda r: (r["precision"], r["offset_m"])  # noqa: E731
    for k, ((precision, offset), found) in enumerate(groupby(rows, key)):
        found = list(found)
        label = f"{precision}, {'at the origin' if not offset else f'{offset / 1000:g} km away'}"
        label += " (default)" if precision == "float64" else ""
        for what, line in (("worst", "-"), ("mean", "--")):
            style = {
                "color": PLOT_COLORS[k],
                "marker": "*" if precision == "float64" else MARKERS[k],
                "ms": 10 if precision == "float64" else 5,
            }
            axes.plot([r["steps"] for r in found], [r[f"{what}_m"] for r in found], ls=line, label=f"{label}, {what}", **style)
    axes.set(xscale="log", yscale="log", xlabel="steps of 1/24 s", ylabel="drift of summed positions, m")
    axes.grid(alpha=0.25)
    _legend(axes)


def _culling(axes, rows: list[dict], what: str, legend: bool) -> None:
    key = lambda r: (r["method"], r["precision"] if "no bound" in r["method"] else "", r["offset_m"])  # noqa: E731
    kinds = {}
    for row in rows:
        kinds.setdefault(key(row), []).append(row)
    floor = min((r[what] for r in rows if r[what]), default=1.0) / 5
    for k, ((name, precision, offset), found) in enumerate(kinds.items()):
        label = ", ".join(filter(None, (name, precision, f"{offset / 1000:g} km away" if offset else "")))
        style = {"color": PLOT_COLORS[k % 7], "marker": MARKERS[k % 7], "ls": "-" if name == "fixed Delta" else "none"}
        style |= {"mfc": "none"} if offset else {}
        _points(axes, found, lambda r: r[what], floor, label=label, **style)
        for row in found if name == "fixed Delta" else ():
            at = (row["ms"], max(row[what], floor))
            if row[what]:
                axes.annotate(f"{row['delta_m']:g} m", at, xytext=(6, 4), textcoords="offset points", fontsize=8)
    for row in rows:
        if row["default"]:
            _star(axes, row, lambda r: r[what], floor)
    says = {"missed": "missed: visible agents culled", "surplus": "surplus: agents kept for nothing"}
    _axes(axes, floor, "ms per frame (bars: least to most)", f"{says[what]}, per frame of {rows[0]['visible']:,.0f} visible")
    if legend:
        _shared_legend(axes)


def _distances(axes, rows: list[dict]) -> None:
    """Plot the worst error of distances against time, by metric and precision."""
    floor = min((r["worst_m"] for r in rows if r["worst_m"]), default=1.0) / 5
    for row in rows:
        away = f", {row['offset_m'] / 1000:g} km away" if row["offset_m"] else ""
        style = _level_style(row, rows) | ({"mfc": "none"} if away else {})
        if row["offset_m"] in LEVEL_OFFSETS[:2]:
            label = f"{row['metric'].lower()}, {row['precision']}{away}"
            _points(axes, [row], lambda r: r["worst_m"], floor, ls="none", label=label, **style)
        if row["default"]:
            _star(axes, row, lambda r: r["worst_m"], floor)
    _axes(axes, floor, "ms per frame (bars: least to most)", "worst error of the distance, m")
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3, frameon=False)


def _ids(axes, rows: list[dict]) -> None:
    """Plot the LOD ids that differ against the crowd's distance from the origin."""
    floor = 0.2e6 / rows[0]["of"]
    kinds = {}
    for row in rows:
        kinds.setdefault((row["metric"].lower(), row["precision"]), []).append(row)
    shift = {key: 1.06**k for k, key in enumerate(kinds)}  # side by side where they agree
    for key, found in kinds.items():
        x = [max(r["offset_m"], LEVEL_OFFSETS[1] / 100) * shift[key] for r in found]
        axes.plot(x, [max(r["differ_ppm"], floor) for r in found], label=", ".join(key), ms=5, **_level_style(found[0], rows))
    _axes(
        axes,
        floor,
        "crowd's distance from the world's origin, m (left: at the origin)",
        f"LOD ids that differ, of a million ({rows[0]['of']:,} looked at)",
    )
    _legend(axes)


def _level_style(row: dict, rows: list[dict]) -> dict:
    ways, metrics = (list(dict.fromkeys(r[key] for r in rows)) for key in ("precision", "metric"))
    return {"color": PLOT_COLORS[ways.index(row["precision"])], "marker": MARKERS[metrics.index(row["metric"])]}
