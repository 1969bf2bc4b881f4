#!/usr/bin/env bash
# Expected: the relative pose error over 1 m compares estimates over 1 m of the true path: so it is defined for
#   benchmarks of odometry, and only so do two estimates have the same pairs.
# Version: evo 1.38.1
# So it is: `evo_rpe` measures the metre along the estimate. Odometry whose distances are half too short is then
#   compared over 2 m of the true path: its error is 1 m in a "metre" instead of 0.5 m.
# Source: code, evo/core/metrics.py, RPE.process_data; seen 2026-11-29 with CPython 3.11
# What to do: `evo_rpe ... --pairs_from_reference`, and RPE(..., pairs_from_reference=True) in Python, wherever
#   estimates are compared with each other or with published figures.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet evo==1.38.1
export HOME="$folder"
venv/bin/python - <<'PY'
def write(path, scale):
    """A straight drive of 20 m, a pose each 0.125 m and second, with distances times a factor."""
    with open(path, "w") as stream:
        stream.writelines(f"{k} {scale * 0.125 * k} 0 0 0 0 0 1\n" for k in range(161))

write("truth.tum", 1.0)
write("short.tum", 0.5)
PY
mean() { venv/bin/evo_rpe tum truth.tum short.tum --delta 1 --delta_unit m "$@" | awk '$1 == "mean" {print $2}'; }
echo "mean error over 1 m: $(mean) m; with pairs from the reference: $(mean --pairs_from_reference) m"
awk -v own="$(mean)" -v true="$(mean --pairs_from_reference)" \
  'BEGIN {exit !(own > 0.99 && own < 1.01 && true > 0.49 && true < 0.51)}'
echo "still so"
