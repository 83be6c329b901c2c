#!/usr/bin/env bash
# Readers of hardness made anew on a machine with GPUs, within the time given: presses, light, pictures, trainings, the paper's rows.
#
#     bash docs/studies/make_reader.sh OUT [SECONDS=1600]
#
# Presses of plan `varied` are made until 0.3 of the time, while the light fields of all sensors are measured; then test presses, unless they
# are there: paper2017's rows in about equal shares, with some natural objects, of two seeds with twelve sensors each. What is trained on is
# drawn into a cache. Then `paper2017`, `varied` and, with the pictures changed more, `families` are trained on, side by side, 40 times through
# it or as often as the time left allows (of 40 times the 28th, 23rd and 37th were the best). Meanwhile rows of plan `gap` are made where there
# is a third GPU, and the networks of before read the tests; at last the new ones do, each and all together, and what counts as unlike is read
# from `gap`. OUT/halfway has them averaged with those of before, spread and novelty fitted anew (docs/studies/halfway.py). OUT/log tells where
# it is, OUT/runs has networks and tables. Called again it goes on with what is there.
# On four H200 with 64 cores: 5.2 presses a second, 13 steps of 64 videos (`families` 7). On two with 32: 5 presses a second once kernels are
# compiled (100 s), 22 videos drawn a second, 12 steps (`families` 6).
# Environment: SEED, TEST_SEEDS, TESTS (episodes that are drawn of, a seed; 0: those that are there), MOST (episodes; where they are there none
# is pressed), RATE (steps a second that are counted on), STEPS, DEVICE (cpu: a trial).
set -u
unset OMP_NUM_THREADS  # nproc heeds it
out=$(realpath -m "$1"); all=${2:-1600}; device=${DEVICE:-cuda}; seed=${SEED:-10}; test_seeds=${TEST_SEEDS:-71 72}; most=${MOST:-100000}
data=$out/data; cache=$out/cache; runs=$out/runs; rows=$out/rows.toml; mkdir -p "$out/log" "$data" "$runs"; SECONDS=0
gpus=$([ "$device" = cuda ] && ls -d /dev/nvidia[0-9]* | wc -l || echo 0); cores=$(nproc); drawers=$(( cores * 2 / 3 + 1 ))
export OMP_NUM_THREADS=1
say() { echo "$SECONDS s: $*" | tee -a "$out/log/run"; }
log() { local name=$1; shift; "$@" >>"$out/log/$name" 2>&1 </dev/null; }
on() { CUDA_VISIBLE_DEVICES=$(( gpus ? $1 % gpus : 0 )) "${@:2}"; }
until_() { local left=$(( $1 * all / 100 - SECONDS )); timeout -k 30 -s INT $(( left > 1 ? left : 1 )) "${@:2}"; }  # per cent of the time
export -f on; export gpus device

[ "$gpus" = 0 ] || nvidia-cuda-mps-control -d || true
python3 - "$out" <<'END'
import sys, tomllib, tomli_w
from gelsim.generate.plan import plan_path
plan = tomllib.loads(plan_path("paper2017").read_text()) | {"name": "rows"}
plan["sensors"]["count"] = 12
gap = tomllib.loads(plan_path("gap").read_text()) | {"name": "gap_rows", "groups": plan["groups"]}
shares = {
    "basic shapes": 0.51, "bad contact": 0.01, "robot": 0.105, "vessels": 0.105, "complicated shapes": 0.21, "natural objects": 0.06
}
for group in plan["groups"]:
    group["share"] = shares[group["name"]]
    for kind in group.get("kinds", []):
        kind["count"] = 65 if kind.get("split") == "novel_shape" else kind["count"]
open(sys.argv[1] + "/rows.toml", "wb").write(tomli_w.dumps(plan).encode())
open(sys.argv[1] + "/gap_rows.toml", "wb").write(tomli_w.dumps(gap).encode())
END
presses() {  # NAME PLAN SEED EPISODES UNTIL SETTINGS
    log "presses_$1" until_ "$5" python3 -m gelsim dataset --plan "$2" --seed "$3" --episodes "$4" --no-light --out "$data/$1" \
        $([ -d "$data/$1" ] && echo --resume) "${@:6}"
    say "$1: $(wc -l <"$data/$1/meta/episodes.jsonl") episodes"
}
field() {  # PLAN SEED NUMBER
    on "$3" python3 -c "
from gelsim.generate.light import Studio
from gelsim.generate.plan import Catalogue, load_plan
Studio('$device').field(Catalogue(load_plan('$1'), $2).sensor_scene($3))"
}
export -f field
[ "$gpus" = 0 ] || for pool in "varied $seed" $(for s in $test_seeds; do echo "$rows,$s"; done); do  # a trial measures those it needs, later
    pool=${pool/,/ }
    python3 -c "
from gelsim.generate.light import is_measured
from gelsim.generate.plan import Catalogue, load_plan
plan = load_plan('${pool% *}')
sensors = Catalogue(plan, ${pool#* })
print(*(number for number in range(plan.sensors) if not is_measured(sensors.sensor_scene(number))), sep='\n')" | sed "/./s|^|$pool |"
done | xargs -r -P $(( 4 * gpus )) -L 1 bash -c 'field "$@"' _ >>"$out/log/fields" 2>&1 &
[ "$(cat "$data/varied/meta/episodes.jsonl" 2>/dev/null | wc -l)" -ge "$most" ] ||
    presses varied varied "$seed" "$most" 30 --test-episodes 0 --device "$device"
wait; say "light fields measured"
[ "${TESTS:-1080}" = 0 ] || for s in $test_seeds; do
    presses "tests_$s" "$rows" "$s" "${TESTS:-1080}" 43 --train-episodes 0 --device "$device" --workers $(( gpus ? cores : cores / 2 + 1 )) &
done
wait

log pictures until_ 78 python3 -m learn.cli train --data "$data/varied" --picture 144,192 --widths 48,96,192,320 --cache "$cache" --steps 1 \
    --batch 2 --warmup 0 --workers "$cores" --out "$runs/pictures" --force
say "drawn"

read_rows() {  # NAME GPU MODEL...
    local s models=(); for s in "${@:3}"; do models+=(--model "$s"); done
    for s in "$data"/tests_* "$data/gap"; do
        [ ! -d "$s" ] || log "rows_$1" on "$2" python3 -m learn.cli eval "${models[@]}" --data "$s" --cache "$cache" --no-baselines \
            --workers "$drawers" --out "$runs/rows_$1_${s##*/}" --force
    done
    say "rows of $1 read"
}
passes=$(( 40 * $(wc -l <"$data/varied/meta/episodes.jsonl") / 64 )); allowed=$(( (all * 90 / 100 - SECONDS - 75) * ${RATE:-13} ))
steps=${STEPS:-$(( passes < allowed ? passes : allowed ))}; say "trainings of $steps steps"
train() {  # NAME GPU SETTINGS
    log "train_$1" on "$2" until_ 92 python3 -m learn.cli train --data "$data/varied" --init "$1" --out "$runs/$1" --force --cache "$cache" \
        --batch "${BATCH:-64}" --rate 0.001 --warmup 150 --end-share 0.6 --drop 0.05 --gain 0.12 --gamma 0.1 --crop 0.08 --steps "$steps" \
        --validate-every $(( steps / 14 + 1 )) $([ "$gpus" = 0 ] || echo --compile true --workers "$cores") "${@:3}"
    say "$1 trained"
    local half=$out/halfway/$1 before; before=$(dirname "$0")/../../assets/models/$1.pt; mkdir -p "$half"
    log "halfway_$1" python3 "$(dirname "$0")/halfway.py" "$before" "$runs/$1/model.pt" "$half/plain.pt"
    log "halfway_$1" on "$2" python3 -m learn.cli train --data "$data/varied" --init "$half/plain.pt" --rate 1e-9 --warmup 0 --steps 1 \
        --batch "${BATCH:-64}" --cache "$cache" --out "$half/fit" --force
    log "halfway_$1" python3 "$(dirname "$0")/halfway.py" "$before" "$runs/$1/model.pt" "$half/model.pt" --fitted "$half/fit/model.pt"
    say "$1 halfway"
}
train paper2017 1 & trainings=($!)
train varied 3 --seed 1 & trainings+=($!)
train families 0 --seed 2 --end-share 0.5 --drop 0.1 --gain 0.25 --gamma 0.25 --turn-deg 15 --mix 0.6 --shade 0.5 --border 0.1 \
    --dirt 0.2 --texture 0.4 --codec-levels 12 --late 0.1 --hide-gel 0.4 & trainings+=($!)
if [ "$gpus" -gt 2 ]; then
    log gap on 2 until_ 84 python3 -m gelsim dataset --plan "$out/gap_rows.toml" --seed 71 --episodes 480 --train-episodes 0 --device cuda \
        --out "$data/gap" --workers $(( cores / 5 ))
    say "gap: $(wc -l <"$data/gap/meta/episodes.jsonl") episodes"
fi
read_rows before 2 default
wait "${trainings[@]}"
networks=(paper2017 varied families); readings=()
for i in 0 1 2; do
    read_rows "${networks[i]}" "$i" "$runs/${networks[i]}/model.pt" & readings+=($!)
done
read_rows default 3 $(printf "$runs/%s/model.pt " "${networks[@]}")
wait "${readings[@]}"
for name in "${networks[@]}"; do
    [ ! -d "$data/gap" ] || log thresholds python3 docs/studies/novelty_threshold.py "$runs/$name/model.pt" "$runs/rows_${name}_gap/predictions.csv"
done
say "done"
