#!/usr/bin/env python3
"""Shows the energyscapes of a running noctule. How they are read is in noctule_client.py.

    python3 energyscape_live.py                        # a window; forward is up, left is left
    python3 energyscape_live.py --once picture.png     # one picture; needs no screen
    python3 energyscape_live.py --print --count 10     # numbers, one line a ping

Exit codes: 0 ok, 2 usage, 65 data that do not fit, 69 nothing there, 73 and 74 a file that cannot be written or read;
when `noctule topics` fails, its own code.
"""

import argparse
import os
import sys

try:
    from noctule_client import INSTALL, Energyscapes, Failure, ask_topics, load_topics, np
except ImportError as missing:
    print(f"energyscape_live: {missing}", file=sys.stderr)
    sys.exit(69)

DYNAMIC_RANGE_DB = 50.0  # between the brightest and the darkest colour
FIGURE_IN = (9.0, 5.4)


class Picture:
    """A polar picture from above: colours are dB, forward is up, left is left."""

    def __init__(self, plt, sensor):
        self.plt, self.sensor, self.grid = plt, sensor, None
        self.figure = plt.figure(figsize=FIGURE_IN)

    def lay_out(self, header):
        """Makes axes for the grid that a header describes. Edges of cells lie half a step around their centres."""
        step_rad = header.direction_step_rad or np.radians(1.0)  # A single direction has no step.
        edges_rad = header.direction_first_rad + step_rad * (np.arange(header.direction_count + 1) - 0.5)
        edges_m = header.range_first_m + header.range_step_m * (np.arange(header.range_count + 1) - 0.5)
        self.figure.clear()
        # matplotlib draws a half disc into the middle of a square, so the square may reach beyond the figure.
        side_in = 7.2 if abs(edges_rad).max() < np.radians(95.0) else 4.2
        width, height = side_in / FIGURE_IN[0], side_in / FIGURE_IN[1]
        self.axes = self.figure.add_axes([0.44 - width / 2, 0.44 - height / 2, width, height], projection="polar")
        self.axes.set_theta_zero_location("N")  # Boresight up. Counter-clockwise is matplotlib's default and ours.
        self.axes.set_thetalim(edges_rad.min(), edges_rad.max())
        nothing = np.zeros((header.range_count, header.direction_count))
        self.mesh = self.axes.pcolormesh(edges_rad, edges_m, nothing, cmap="inferno")
        self.axes.set_rlim(0.0, edges_m[-1])
        self.axes.yaxis.set_major_formatter("{x:g} m")
        self.axes.grid(color="grey", alpha=0.5)
        self.figure.colorbar(self.mesh, cax=self.figure.add_axes([0.91, 0.1, 0.02, 0.7]), label="dB re full scale")

    def show(self, ping):
        """Draws a ping."""
        head = ping.header
        grid = (
            ping.image.shape,
            head.direction_first_rad,
            head.direction_step_rad,
            head.range_first_m,
            head.range_step_m,
        )
        if grid != self.grid:  # At first, and when noctule was restarted with another grid.
            self.lay_out(head)
            self.grid = grid
        range_m, bearing_deg, value = ping.peak()
        level_db = 20.0 * np.log10(np.maximum(ping.image, 1e-9))
        self.mesh.set_array(level_db.T)
        self.mesh.set_clim(level_db.max() - DYNAMIC_RANGE_DB, level_db.max())
        peak = f"peak at {range_m:.2f} m, {bearing_deg:+.1f}°, {level_db.max():.1f} dB" if value > 0.0 else "no echo"
        self.figure.suptitle(f"{self.sensor}, ping {head.sequence}, {ping.age_ms():.0f} ms old\n{peak}")


def import_pyplot(backend=None):
    try:
        import matplotlib
    except ImportError as error:
        raise Failure(69, f"{error}; {INSTALL}") from error
    if backend:
        matplotlib.use(backend)
    import matplotlib.pyplot as plt

    return plt


def save_picture(energyscapes, path, timeout_s):
    plt = import_pyplot("Agg")  # Draws into memory, without a screen.
    picture = Picture(plt, energyscapes.sensor)
    picture.show(energyscapes.next(timeout_s))
    try:
        picture.figure.savefig(path, format="png", dpi=100)
    except OSError as error:
        raise Failure(73, f"cannot write {path}: {error.strerror}") from error


def show_window(energyscapes, timeout_s):
    plt = import_pyplot()
    if plt.get_backend().lower() == "agg":
        raise Failure(69, "matplotlib found no screen or no window toolkit (python3-tk, PyQt6); try --once or --print")
    plt.rcParams["figure.raise_window"] = False  # Otherwise every ping would push the window in front of all others.
    picture = Picture(plt, energyscapes.sensor)
    plt.show(block=False)
    while plt.fignum_exists(picture.figure.number):
        # While nothing new is there the window has to be kept alive. Pings that come while it is drawn are skipped.
        picture.show(energyscapes.next(timeout_s, idle=lambda: plt.pause(0.01)))
        plt.pause(0.001)


def print_lines(energyscapes, count, timeout_s):
    """Numbers as `name=value`, so that programs can read them as well."""
    printed = 0
    while count == 0 or printed < count:
        ping = energyscapes.next(timeout_s)
        range_m, bearing_deg, value = ping.peak()
        place = f"range_m={range_m:.4f} bearing_deg={bearing_deg:.3f} value={value:.6g}"
        stamp = (
            f"sequence={ping.header.sequence} t_monotonic_ns={ping.header.t_monotonic_ns} age_ms={ping.age_ms():.1f}"
        )
        print(f"{place} {stamp} lost={ping.lost}", flush=True)
        printed += 1


def arguments():
    parser = argparse.ArgumentParser(description="Shows the energyscapes of a running noctule.")
    parser.add_argument("--sensor", metavar="NAME", help="default: the first sensor of the configuration")
    parser.add_argument(
        "--noctule", metavar="PATH", default="noctule", help="program that tells the layout of the data"
    )
    parser.add_argument(
        "--config", metavar="FILE", help="configuration that the daemon runs with; passed on to noctule"
    )
    parser.add_argument(
        "--topics", metavar="FILE", help="saved output of `noctule topics --json`; then noctule is not run"
    )
    parser.add_argument("--once", metavar="OUT.png", help="save one picture and end")
    parser.add_argument("--print", action="store_true", help="print numbers, one line a ping")
    parser.add_argument("--count", metavar="N", type=int, default=0, help="end --print after N lines")
    parser.add_argument("--timeout", metavar="S", type=float, default=5.0, help="longest wait for a ping (default: 5)")
    args = parser.parse_args()
    if args.once and args.print:
        parser.error("--once and --print exclude each other")
    if not 0.0 < args.timeout <= 3600.0:
        parser.error(f"--timeout {args.timeout:g}: above 0 and at most 3600 is allowed")
    if args.count < 0:
        parser.error(f"--count {args.count}: 0 (no end) or more is allowed")
    return args


def main():
    args = arguments()
    topics = load_topics(args.topics) if args.topics else ask_topics(args.noctule, args.config)
    energyscapes = Energyscapes(topics, args.sensor, args.timeout)
    if args.print:
        print_lines(energyscapes, args.count, args.timeout)
    elif args.once:
        save_picture(energyscapes, args.once, args.timeout)
    else:
        show_window(energyscapes, args.timeout)


if __name__ == "__main__":
    try:
        main()
    except Failure as failure:
        print(f"energyscape_live: {failure}", file=sys.stderr)
        sys.exit(failure.code)
    except BrokenPipeError:
        os._exit(0)  # Whoever read our lines has enough, as in `... --print | head`.
    except KeyboardInterrupt:
        sys.exit(130)
