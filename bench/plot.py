"""Draws figures as SVG: plot.py FOLDER, with a JSON object of file names and figures on standard input.

bench/src/plot.rs and ambf-app/examples/parity_report.rs describe the kinds of figures. scripts/plot installs what this needs."""

import json
import pathlib
import sys

import matplotlib

matplotlib.use("svg")
# Texts stay texts, and the same figure gives the same file.
matplotlib.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "ambf", "figure.figsize": (8, 4.6)})
from matplotlib import pyplot  # noqa: E402  # the backend is chosen before


def draw_lines(figure, axes):
    """Named lines over linear or logarithmic axes."""
    is_log = figure["kind"] == "log lines"
    for line in figure["lines"]:
        points = [point for point in line["points"] if not is_log or min(point) > 0]
        axes.plot(*zip(*points) if points else ((), ()), label=line["name"], marker="o" if is_log else None, ms=4)
    if is_log:
        axes.set(xscale="log", yscale="log")
        ticks = [tick for tick in figure["ticks"] if axes.get_xlim()[0] <= tick <= axes.get_xlim()[1]]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
    else:
        axes.set(xlim=(0, None), ylim=(0, figure["y max"]))
    axes.set(xlabel=figure["x"], ylabel=figure["y"])
    axes.grid(color="0.9")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)


def draw_bars(figure, axes):
    """Groups of horizontal bars with their values."""
    series, rows = figure["series"], figure["rows"]
    axes.figure.set_figheight(1.2 + 0.18 * len(rows) * (len(series) + 1))
    height = 0.9 / len(series)
    for i, name in enumerate(series):
        values = [values[i] or float("nan") for _, values in rows]
        bars = axes.barh([row + (i + 0.5) * height - 0.45 for row in range(len(rows))], values, height, label=name)
        axes.bar_label(bars, [f"{value:.0f} {figure['unit']}" if value == value else "" for value in values], padding=3)
    axes.set_yticks(range(len(rows)), [name for name, _ in rows])
    axes.invert_yaxis()
    axes.margins(x=0.15)
    axes.legend(frameon=False)


def draw_cells(figure, axes):
    """Blocks of rows of coloured cells."""
    rows = [(title if i == 0 else "", *row) for title, block in figure["blocks"] for i, row in enumerate(block)]
    width = max((len(cells) for _, _, cells in rows), default=1)
    axes.figure.set_size_inches(4.5 + 0.75 * width, 1 + 0.24 * len(rows))
    for y, (title, name, cells) in enumerate(rows):
        axes.text(-0.1, y + 0.5, name, ha="right", va="center", fontsize=8)
        axes.text(-5.2, y + 0.5, title, ha="left", va="center", fontsize=8, weight="bold")
        for x, (text, colour) in enumerate(cells):
            axes.add_patch(pyplot.Rectangle((x, y), 0.97, 0.95, color=colour, lw=0))
            axes.text(x + 0.5, y + 0.5, text, ha="center", va="center", fontsize=7)
    keys = [pyplot.Rectangle((0, 0), 1, 1, color=colour) for _, colour in figure["legend"]]
    names = [name for name, _ in figure["legend"]]
    axes.legend(keys, names, ncols=len(keys), loc="lower left", bbox_to_anchor=(0, 1.0), frameon=False)
    axes.set(xlim=(-5.3, width), ylim=(len(rows), 0))
    axes.axis("off")


def draw_panels(figure, panels):
    """Distances over time, one panel a scene."""
    for axes, panel in zip(panels, figure["panels"]):
        for line in panel["lines"]:
            points = [(x, y) for x, y in line["points"] if y and y > 0]
            axes.plot(*zip(*points) if points else ((), ()), color=line["colour"], lw=line["width"], label=line["name"])
        axes.set(yscale="log", title=panel["title"], xlabel="time, s", ylim=figure["y range"])
        axes.grid(color="0.9")
    panels[0].set_ylabel(figure["y"])
    handles, labels = panels[0].get_legend_handles_labels()
    shown = dict(zip(labels, handles))
    panels[0].figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=len(shown), frameon=False)


def draw(figure):
    """The figure, drawn."""
    if figure["kind"] == "panels":
        count = len(figure["panels"])
        size = (3.2 * count, 4)
        drawn, panels = pyplot.subplots(1, count, sharey=True, squeeze=False, layout="constrained", figsize=size)
        draw_panels(figure, panels[0])
        drawn.suptitle(figure["title"])
        return drawn
    kinds = {"log lines": draw_lines, "linear lines": draw_lines, "bars": draw_bars, "cells": draw_cells}
    drawn, axes = pyplot.subplots(layout="constrained")
    kinds[figure["kind"]](figure, axes)
    drawn.suptitle(figure["title"])
    return drawn


def main(folder):
    """Draws all figures of standard input into the folder."""
    for name, figure in json.load(sys.stdin).items():
        drawn = draw(figure)
        drawn.savefig(pathlib.Path(folder) / name, metadata={"Date": None})
        pyplot.close(drawn)


if __name__ == "__main__":
    main(sys.argv[1])
