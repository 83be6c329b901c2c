#!/usr/bin/env bash
# Readers of hardness made anew on a machine with GPUs, within the time given: presses, light, pictures, trainings, the paper's rows.
#
#     bash docs/studies/make_reader.sh OUT [SECONDS=1600]
#
# Presses of plans `varied` and `families` and of paper2017's test rows are made side by side until 0.42 of the time, while the light fields of
# their sensors are measured; then all are drawn into one cache; then four trainings run, one a GPU, with as many steps as the time left
# allows; each network and the shipped ones read the test rows. OUT/log tells where it is, OUT/runs has networks and tables. Called again it
# goes on with the presses and drawings that are there.
# On four H100 with 64 cores: 9 presses a second, 39 drawn ones, 12 steps of 64 presses a second and GPU. Environment: SEED, TEST_SEED, TESTS
# (episodes), MOST (episodes of a plan), STEPS (in place of what the time allows), DEVICE (cpu: a trial).
set -u
out=$(realpath -m "$1"); all=${2:-1600}; device=${DEVICE:-cuda}; seed=${SEED:-9}; test_seed=${TEST_SEED:-41}; most=${MOST:-100000}
data=$out/data; cache=$out/cache; runs=$out/runs; mkdir -p "$out/log" "$data"; SECONDS=0
gpus=$([ "$device" = cuda ] && ls -d /dev/nvidia[0-9]* | wc -l || echo 0); cores=$(nproc)
processes=$(( gpus ? (2 * cores < 32 * gpus ? 2 * cores : 32 * gpus) : cores )); lights=$(( gpus ? 2 * gpus : 1 ))
export OMP_NUM_THREADS=1
say() { echo "$SECONDS s: $*" | tee -a "$out/log/run"; }
log() { name=$1; shift; "$@" >>"$out/log/$name" 2>&1 </dev/null; }
on() { CUDA_VISIBLE_DEVICES=$(( gpus ? $1 % gpus : 0 )) "${@:2}"; }
until_() { local left=$(( $1 * all / 100 - SECONDS )); timeout -k 30 -s INT $(( left > 1 ? left : 1 )) "${@:2}"; }  # per cent of the time
export -f on; export gpus device

[ "$gpus" = 0 ] || nvidia-cuda-mps-control -d || true
presses() {  # NAME PLAN SEED EPISODES PER_CENT_OF_THE_WORKERS LIMIT
    log "presses_$1" until_ 42 python3 -m gelsim dataset --plan "$2" --seed "$3" --episodes "$4" "$6" 0 --no-light --device "$device" \
        --workers $(( $5 * processes / 100 + 1 )) --out "$data/$1" $([ -d "$data/$1" ] && echo --resume)
}
field() {  # PLAN SEED NUMBER
    on "$3" python3 -c "
from gelsim.generate.light import Studio, is_measured
from gelsim.generate.plan import Catalogue, load_plan
sensor = Catalogue(load_plan('$1'), $2).sensor_scene($3)
is_measured(sensor) or Studio('$device').field(sensor)"
}
export -f field
presses tests paper2017 "$test_seed" "${TESTS:-1400}" 18 --train-episodes &
presses varied varied "$seed" "$most" 34 --test-episodes &
presses families families "$seed" "$most" 48 --test-episodes &
[ "$gpus" = 0 ] || for pool in "varied $seed" "families $seed" "paper2017 $test_seed"; do  # a trial measures those it needs, later
    python3 -c "from gelsim.generate.plan import load_plan; print(*range(load_plan('${pool% *}').sensors), sep='\n')" | sed "s/^/$pool /"
done | xargs -P "$lights" -L 1 bash -c 'field "$@"' _ >>"$out/log/fields" 2>&1 &
wait
for name in families varied tests; do say "$name: $(wc -l <"$data/$name/meta/episodes.jsonl") episodes"; done

drawers=$(( gpus ? cores * 15 / 16 : cores ))
size=(--picture 144,192 --widths 48,96,192,320)
log pictures until_ 66 python3 -m learn.cli train --data "$data/varied" --real "$data/families" "${size[@]}" --cache "$cache" --steps 1 \
    --batch 2 --warmup 0 --workers "$drawers" --out "$runs/pictures" --force
log pictures until_ 66 python3 -m learn.cli eval --model paper2017 --data "$data/tests" --cache "$cache" --no-baselines \
    --workers "$drawers" --out "$runs/rows_paper2017" --force
say "drawn"

steps=${STEPS:-$(( (all * 95 / 100 - SECONDS - 75) * 12 ))}; say "trainings of $steps steps"
train() {  # NAME GPU SETTINGS
    log "train_$1" on "$2" until_ 97 python3 -m learn.cli train --out "$runs/$1" --force --cache "$cache" --batch "${BATCH:-64}" --warmup 150 \
        --steps "$steps" --validate-every $(( steps / 14 + 1 )) $([ "$gpus" = 0 ] || echo --compile true --workers $(( cores * 13 / 64 ))) "${@:3}"
    log "rows_$1" on "$2" python3 -m learn.cli eval --model "$runs/$1/model.pt" --data "$data/tests" --cache "$cache" --no-baselines \
        --out "$runs/rows_$1" --force
}
weak=(--end-share 0.6 --drop 0.05 --gain 0.12 --gamma 0.1 --crop 0.08)
families=(--preset families --rate 0.0007)
both=(--data "$data/varied" --real "$data/families" --real-ratio 0.5)
train both 0 "${families[@]}" --init paper2017 "${both[@]}" &
train both_varied 1 "${families[@]}" --init varied --seed 1 "${both[@]}" &
train rows 2 --rate 0.001 "${weak[@]}" --init paper2017 --data "$data/varied" &
train families 3 "${families[@]}" --init paper2017 --seed 2 --data "$data/families" &
log rows_varied on 3 python3 -m learn.cli eval --model varied --data "$data/tests" --cache "$cache" --no-baselines --out "$runs/rows_varied" --force &
wait
say "done"
