#!/usr/bin/env bash
# What do pictures in millimetres, sensors of all families and objects beyond silicone bring to the reading of real things? Three ablations.
#
#     bash docs/studies/reader_ablation.sh OUT [SECONDS=1500]         on a machine with GPUs
#     python docs/studies/reader_ablation.py OUT/runs FOLDER --mm-per-px 0.058 --sensor gelsight_mini         the table, anywhere
#
# Four sets of presses are made side by side until 0.42 of the time, while the light fields of their sensors are measured: `varied` (domes as
# paper2017's, silicone), `families`, its sensors with silicone alone, its objects on varied's sensors. Each is drawn. Then each way is
# trained with three seeds from `paper2017`, half of its presses from `varied`, the other half as its name says; all sets are cut to the
# smallest's number of presses. OUT/log tells where it is.
# The machine must have nothing else to do: beside 58 busy cores of 64 nothing was drawn in 24 % of 1,150 s.
# Called again it goes on with the presses and drawings that are there. Environment: SEED, MOST (presses of a set), STEPS, DEVICE (cpu: a trial).
set -u
unset OMP_NUM_THREADS  # nproc heeds it
out=$(realpath -m "$1"); all=${2:-1500}; device=${DEVICE:-cuda}; seed=${SEED:-11}; most=${MOST:-100000}
data=$out/data; cache=$out/cache; runs=$out/runs; mkdir -p "$out/log" "$out/plans" "$data" "$runs"; SECONDS=0
gpus=$([ "$device" = cuda ] && ls -d /dev/nvidia[0-9]* | wc -l || echo 0); cores=${CORES:-$(nproc)}
processes=$(( gpus ? (2 * cores < 32 * gpus ? 2 * cores : 32 * gpus) : cores ))
export OMP_NUM_THREADS=1
say() { echo "$SECONDS s: $*" | tee -a "$out/log/run"; }
log() { name=$1; shift; "$@" >>"$out/log/$name" 2>&1 </dev/null; }
until_() { local left=$(( $1 * all / 100 - SECONDS )); timeout -k 30 -s INT $(( left > 1 ? left : 1 )) "${@:2}"; }  # per cent of the time

python3 - "$out/plans" <<'END'
import sys, tomllib
from pathlib import Path

import tomli_w

here, plans = Path(sys.argv[1]), Path("scenes/plans")
families = tomllib.loads((plans / "families.toml").read_text())
varied = tomllib.loads((plans / "varied.toml").read_text())
silicone = lambda kind: not {"rigid", "poissons_ratio"} & set(kind["object"])
groups = [group | {"kinds": list(filter(silicone, group["kinds"]))} if "kinds" in group else group for group in families["groups"]]
(here / "sensors.toml").write_text(tomli_w.dumps(families | {"name": "sensors", "groups": groups}))
# Sensors, pictures and gels are those of `varied` where a plan says nothing of them.
(here / "objects.toml").write_text(tomli_w.dumps(varied | {"name": "objects", "groups": families["groups"]}))
END
declare -A plan=([varied]=varied [families]=families [sensors]=$out/plans/sensors.toml [objects]=$out/plans/objects.toml)
[ "$gpus" = 0 ] || nvidia-cuda-mps-control -d || true
field() {  # PLAN NUMBER; the two other sets have the sensors of these
    CUDA_VISIBLE_DEVICES=$(( $2 % gpus )) python3 -c "
from gelsim.generate.light import Studio, is_measured
from gelsim.generate.plan import Catalogue, load_plan
sensor = Catalogue(load_plan('$1'), $seed).sensor_scene($2)
is_measured(sensor) or Studio('cuda').field(sensor)"
}
export -f field; export gpus seed
[ "$gpus" = 0 ] || for pool in families varied; do  # a trial measures those it needs, later
    python3 -c "from gelsim.generate.plan import load_plan; print(*range(load_plan('$pool').sensors), sep='\n')" | sed "s/^/$pool /"
done | xargs -P $(( 2 * gpus + 1 )) -L 1 bash -c 'field "$@"' _ >>"$out/log/fields" 2>&1 &
for name in "${!plan[@]}"; do
    log "presses_$name" until_ 42 python3 -m gelsim dataset --plan "${plan[$name]}" --seed "$seed" --episodes "$most" --test-episodes 0 --no-light \
        --device "$device" --workers $(( processes / 4 + 1 )) --out "$data/$name" $([ -d "$data/$name" ] && echo --resume) &
done
wait
for name in "${!plan[@]}"; do say "$name: $(wc -l <"$data/$name/meta/episodes.jsonl") videos"; done

size=(--picture 144,192 --widths 48,96,192,320)
number=0
for name in "${!plan[@]}"; do  # each is drawn while a training of one step reads it
    CUDA_VISIBLE_DEVICES=$(( gpus ? number % gpus : 0 )) log "pictures_$name" until_ 66 python3 -m learn.cli train --data "$data/$name" \
        "${size[@]}" --cache "$cache" --steps 1 --batch 2 --warmup 0 --workers "$(( cores / 4 + 1 ))" --out "$out/drawn_$name" --force &
    number=$(( number + 1 ))
done
wait
say "drawn"

fewest=$(for name in "${!plan[@]}"; do
    python3 -c "import json, sys; print(len(json.load(open(sys.argv[1]))['train']))" "$data/$name/meta/splits.json"
done | sort -n | head -1)
at_once=$(( gpus ? 2 * gpus : 1 )); rounds=$(( (15 + at_once - 1) / at_once ))
steps=${STEPS:-$(( (all * 95 / 100 - SECONDS - 30 * rounds) / rounds * 7 ))}; say "15 trainings of $steps steps on $fewest videos of each set"
train() {  # NAME SEED NUMBER SETTINGS
    CUDA_VISIBLE_DEVICES=$(( gpus ? $3 % gpus : 0 )) log "train_$1-$2" until_ 99 python3 -m learn.cli train --out "$runs/$1-$2" --force \
        --cache "$cache" --preset families --init paper2017 --rate 0.0007 --batch "${BATCH:-64}" --steps "$steps" --seed "$2" \
        --validate-every $(( steps / 4 + 1 )) --data "$data/varied" --presses "$fewest" "${@:4}"
}
number=0
for turn in 1 2 3; do
    while read -r name rest; do
        while [ "$(jobs -rp | wc -l)" -ge "$at_once" ]; do wait -n; done
        train "$name" "$turn" "$number" $rest &
        number=$(( number + 1 ))
    done <<END
all --real $data/families --real-presses $fewest
whole_pictures --real $data/families --real-presses $fewest --hide-scale 1
without_sensors --real $data/objects --real-presses $fewest
without_objects --real $data/sensors --real-presses $fewest
without_both
END
done
wait; say "done"
