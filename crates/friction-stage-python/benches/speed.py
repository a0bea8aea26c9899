"""Time of a simulation in Python over that in Rust.

    cargo build --release -p friction-stage-lab --example timed_simulation
    python crates/friction-stage-python/benches/speed.py target/release/examples/timed_simulation

Both run the fast move after 20 s of rest, in turn, so that whatever else the machine does falls on
both.
"""

import subprocess
import sys
import time

import numpy as np
from friction_stage import Model, Motion, simulate

RUNS = 200


def main(program: str) -> None:
    model, motion = Model.guide("guide_2"), Motion.fast_move(rest=20.0)
    with subprocess.Popen(
        [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    ) as rust:
        assert rust.stdin is not None and rust.stdout is not None
        times = []
        for _ in range(RUNS + 10):
            rust.stdin.write("\n")
            in_rust = float(rust.stdout.readline())
            start = time.perf_counter()
            trace = simulate(model, motion)
            times.append((time.perf_counter() - start, in_rust))
            rows = trace.rows
            # Its memory is given back outside of the times, as that of Rust is.
            del trace
        rust.stdin.close()
    python, rust_times = np.array(times[10:]).T
    low, middle, high = np.quantile(python / rust_times, [0.25, 0.5, 0.75])
    print(
        f"{rows} samples, {RUNS} runs each: Rust {1e3 * np.median(rust_times):.2f} ms, "
        f"Python {1e3 * np.median(python):.2f} ms"
    )
    print(f"Python over Rust: median {middle:.3f}, half of the runs {low:.3f} to {high:.3f}")


if __name__ == "__main__":
    main(sys.argv[1])
