#!/usr/bin/env bash
# Measures one GPU: whether it computes what the CPU does, the speed and the memory of world and training, and the time to
# discover each of experiments A to F. Takes half an hour, most of it for the discoveries.
#
#   CUDA=cuda12 OUT=runs/gpu benchmarks/gpu.sh        (CUDA=cuda13 for newer drivers)
#
# Leaves $OUT/gpu.md (all tables), gpu.json, gpu.png and a run folder for each experiment. Continues where it was interrupted.
set -euo pipefail
cd "$(dirname "$0")/.."
CUDA=${CUDA:-cuda12}
OUT=${OUT:-runs/gpu}
PYTHON=${PYTHON:-python3}
VENV=${VENV:-.venv-gpu}
case $CUDA in cuda12 | cuda13) ;; *) echo "CUDA=$CUDA: must be cuda12 or cuda13" >&2; exit 2 ;; esac

if [ ! -e "$VENV/.installed" ]; then
    "$PYTHON" -m venv "$VENV"
    "$VENV/bin/python" -m pip install --quiet --disable-pip-version-check --constraint constraints.txt \
        --editable ".[dev,benchmark,$CUDA]"
    touch "$VENV/.installed"
fi
BIN=$VENV/bin
"$BIN/python" - <<'PYTHON' || { echo "no GPU that JAX finds: see nvidia-smi, and CUDA=cuda13 for newer drivers" >&2; exit 2; }
import sys
import jax
print(f"{jax.devices()[0].device_kind}, {jax.device_count()} of them; jax {jax.__version__}")
sys.exit(jax.default_backend() != "gpu")
PYTHON
export CUDA_VISIBLE_DEVICES=${CUDA_VISIBLE_DEVICES:-0}
# Peak memory is measured in other processes, so none may reserve most of the device's memory.
export XLA_PYTHON_CLIENT_PREALLOCATE=false
mkdir -p "$OUT"
AGREES=yes

echo "== 1 of 4: does it compute what the CPU does"
{
    echo "## Agreement with the CPU"
    echo
    "$BIN/python" -m benchmarks.agreement || AGREES=no
    echo
} | tee "$OUT/agreement.md"

echo "== 2 of 4: the tests of kernels, world and learner, on it"
"$BIN/python" -m pytest tests/geometry tests/world tests/policies tests/learning -p no:cacheprovider ||
    echo "Some tests fail on this device." | tee -a "$OUT/agreement.md"

echo "== 3 of 4: speed, and memory"
"$BIN/python" -m benchmarks --wide --out "$OUT/speed.md" --json "$OUT/gpu.json" --figure "$OUT/gpu.png"

echo "== 4 of 4: time to discover"
for experiment in A B C D E F; do
    "$BIN/python" -m murmurate discover "$experiment" --resume --out "$OUT/$experiment" || [ $? -eq 3 ]
done
{
    cat "$OUT/agreement.md" "$OUT/speed.md"
    echo
    echo "## Time to discover"
    echo
    "$BIN/python" -m murmurate table "$OUT"/[A-F]
} > "$OUT/gpu.md"
echo "all of it: $OUT/gpu.md"
grep -q "| no |" "$OUT/agreement.md" && { echo "it does NOT compute what the CPU does: see $OUT/agreement.md" >&2; exit 1; }
exit 0
