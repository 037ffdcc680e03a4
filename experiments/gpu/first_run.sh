#!/usr/bin/env bash
# Everything there is to check on a machine with a GPU, and one report in Markdown:
#
#   experiments/gpu/first_run.sh [--out FOLDER] [--quick] [--platform cuda]
#
# Run it in an environment with the extras "cuda", "test" and "experiments". A part that fails does not stop the others.
# Exit code: 0 if all parts passed, 1 if one failed, 2 without a GPU. --quick takes small sizes and few tests;
# --platform cpu tries the script itself on a machine without a GPU.
set -u
cd "$(dirname "$0")/../.." || exit 1

out="runs/gpu" quick="" platform="cuda"
while [ $# -gt 0 ]; do
    case "$1" in
        --out) out="$2"; shift 2 ;;
        --platform) platform="$2"; shift 2 ;;
        --quick) quick="yes"; shift ;;
        *) echo "first_run: unknown option $1; it takes --out FOLDER, --quick, --platform NAME" >&2; exit 1 ;;
    esac
done

# The CPU stays there beside the GPU: callbacks and comparisons need it.
export JAX_PLATFORMS="$platform,cpu"
[ "$platform" = cpu ] && export JAX_PLATFORMS=cpu
# JAX goes on with the CPU where the other platform is missing, so it is asked by name.
look='import sys, jax; print("\n".join(f"{d.id}: {d.device_kind}" for d in jax.devices(sys.argv[1])))'
if ! devices=$(python -c "$look" "$platform" 2> /dev/null); then
    echo "first_run: JAX finds no device of platform $platform, so nothing was run"
    exit 2
fi

mkdir -p "$out"
report="$out/report.md"
summary="$out/summary.md"
details="$out/details.md"
: > "$details"
printf '| part | result | seconds |\n| --- | --- | --- |\n' > "$summary"
failed=0

# part NAME LIMIT COMMAND...: run it for at most LIMIT seconds, keep its output, and go on.
part() {
    local name="$1" limit="$2" log="$out/${1// /_}.log" start=$SECONDS code result
    shift 2
    echo "first_run: $name"
    timeout "$limit" "$@" > "$log" 2>&1
    code=$?
    result="passed"
    [ $code -ne 0 ] && result="failed (exit code $code)" && failed=1
    [ $code -eq 124 ] && result="not done after $limit s"
    echo "| $name | $result | $((SECONDS - start)) |" >> "$summary"
    { printf '\n## %s\n\n`%s`\n\n```text\n' "$name" "$*"; tail -n 60 "$log"; printf '```\n'; } >> "$details"
}

# Processes share the GPU, so none may take most of its memory at once.
export XLA_PYTHON_CLIENT_PREALLOCATE=false

part "machine" 300 bash -c 'nvidia-smi; python -m experiments.gpu.machine'
if [ -n "$quick" ]; then
    part "tests" 1800 python -m pytest -n 0 -q tests/geometry/queries/test_purity.py
    part "devices" 1800 python -m experiments.gpu.devices --device "$platform" --device cpu --case "README, depth 2" \
        --size 16 --spp 2 --out "$out"
    part "chart" 1800 jaxdr chart configs/chart_quick.toml --set "output=$out/chart" --set "samples=[1]" --set keys=8 \
        --set memory=false --set terms=0
    part "scaling" 1800 python -m experiments.gpu.scaling --platform "$platform" --quick --out "$out"
else
    part "tests" 7200 python -m pytest -n 4 -q
    part "devices" 7200 python -m experiments.gpu.devices --device "$platform" --device cpu --out "$out"
    part "larger chunks" 3600 python -m experiments.gpu.devices --device "$platform" --chunk-size 1048576 --size 512 \
        --out "$out"
    part "speed" 3600 python -m experiments.gpu.speed --device "$platform" --out "$out"
    part "chart" 3600 jaxdr chart configs/chart_quick.toml --set "output=$out/chart"
    part "scaling" 3600 python -m experiments.gpu.scaling --platform "$platform" --out "$out"
fi
part "oracles" 7200 env PYTHONPATH="$PWD" python experiments/data/reference_scenes/check.py \
    --spp "$([ -n "$quick" ] && echo 16 || echo 512)"

{
    printf '# First run on %s\n\n' "$platform"
    printf '%s, commit %s\n\n```text\n%s\n```\n\n' "$(date -u +%F)" "$(git rev-parse --short HEAD 2> /dev/null)" "$devices"
    cat "$summary" "$details"
} > "$report"
rm "$summary" "$details"
echo "first_run: $report"
exit $failed
