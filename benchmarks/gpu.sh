#!/usr/bin/env bash
# Measures one GPU: whether it computes what the CPU does, the speed and the memory of world and training, and the time to
# discover each of experiments A to F. Takes half an hour, most of it for the discoveries.
#
#   CUDA=cuda12 OUT=runs/gpu benchmarks/gpu.sh        (CUDA=cuda13 for newer drivers)
#   INSTALL=no PYTHON=python3 PARTS="agreement speed" ROBOTS="4 10 128" benchmarks/gpu.sh
#
# INSTALL=no uses the packages that PYTHON has. PARTS (agreement, tests, speed, discover), ROBOTS and EXPERIMENTS say
# what is measured; without them, all is.
#
# Leaves $OUT/gpu.md (all tables), gpu.json, gpu.png and a run folder for each experiment. Continues where it was interrupted.
set -euo pipefail
cd "$(dirname "$0")/.."
CUDA=${CUDA:-cuda12}
OUT=${OUT:-runs/gpu}
PYTHON=${PYTHON:-python3}
INSTALL=${INSTALL:-yes}
VENV=${VENV:-.venv-gpu}
PARTS=${PARTS:-agreement tests speed discover}
EXPERIMENTS=${EXPERIMENTS:-A B C D E F}
case $CUDA in cuda12 | cuda13) ;; *) echo "CUDA=$CUDA: must be cuda12 or cuda13" >&2; exit 2 ;; esac
case $INSTALL in yes | no) ;; *) echo "INSTALL=$INSTALL: must be yes or no" >&2; exit 2 ;; esac
for part in $PARTS; do
    case $part in
        agreement | tests | speed | discover) ;;
        *) echo "PARTS=$PARTS: $part: must be agreement, tests, speed or discover" >&2; exit 2 ;;
    esac
done

if [ "$INSTALL" = no ]; then
    export PYTHONPATH="src${PYTHONPATH:+:$PYTHONPATH}"
else
    if [ ! -e "$VENV/.installed" ]; then
        "$PYTHON" -m venv "$VENV"
        "$VENV/bin/python" -m pip install --quiet --disable-pip-version-check --constraint constraints.txt \
            --editable ".[dev,benchmark,$CUDA]"
        touch "$VENV/.installed"
    fi
    PYTHON=$VENV/bin/python
fi
"$PYTHON" - <<'PYTHON' || { echo "no GPU that JAX finds: see nvidia-smi, and CUDA=cuda13 for newer drivers" >&2; exit 2; }
import sys
import jax
print(f"{jax.devices()[0].device_kind}, {jax.device_count()} of them; jax {jax.__version__}")
sys.exit(jax.default_backend() != "gpu")
PYTHON
export CUDA_VISIBLE_DEVICES=${CUDA_VISIBLE_DEVICES:-0}
# Peak memory is measured in other processes, so none may reserve most of the device's memory.
export XLA_PYTHON_CLIENT_PREALLOCATE=false
mkdir -p "$OUT"

asked() { [[ " $PARTS " == *" $1 "* ]]; }

if asked agreement; then
    echo "== does it compute what the CPU does"
    {
        echo "## Agreement with the CPU"
        echo
        "$PYTHON" -m benchmarks.agreement || true
        echo
    } | tee "$OUT/agreement.md"
fi
if asked tests; then
    echo "== the tests of kernels, world and learner, on it"
    # With the programs that it runs otherwise: the tests' own compiler flags are for CPUs.
    MURMURATE_TEST_COMPILER=full "$PYTHON" -m pytest tests/geometry tests/world tests/policies tests/learning \
        -p no:cacheprovider -p no:benchmark -n "${WORKERS:-4}" | tee "$OUT/tests.txt" ||
        echo "Some tests fail on this device: see tests.txt." | tee -a "$OUT/agreement.md"
fi
if asked speed; then
    echo "== speed, and memory"
    "$PYTHON" -m benchmarks --wide ${ROBOTS:+--robots $ROBOTS} \
        --out "$OUT/speed.md" --json "$OUT/gpu.json" --figure "$OUT/gpu.png"
fi
if asked discover; then
    echo "== time to discover"
    for experiment in $EXPERIMENTS; do
        "$PYTHON" -m murmurate discover "$experiment" --resume --out "$OUT/$experiment" || [ $? -eq 5 ]
    done
    {
        echo "## Time to discover"
        echo
        "$PYTHON" -m murmurate table "$OUT"/[A-F]
    } > "$OUT/discover.md"
fi
for part in agreement speed discover; do
    [ ! -e "$OUT/$part.md" ] || { cat "$OUT/$part.md"; echo; }
done > "$OUT/gpu.md"
echo "all of it: $OUT/gpu.md"
if grep -qs "| no |" "$OUT/agreement.md"; then
    echo "it does NOT compute what the CPU does: see $OUT/agreement.md" >&2
    exit 1
fi
