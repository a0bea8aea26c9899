#!/bin/sh
# From a recording to a better machine: a stage with a hidden effect is recorded, identified, tuned
# and compensated.
# usage: examples/compensate/run.sh [DIRECTORY FOR THE RESULTS] [SEED] [MODEL OF THE STAGE]
# A seed draws the effect, or a model has it: cogging.yaml, cable.yaml and bristles.yaml do.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
out=${1:-compensated}
fs=${FRICTION_STAGE:-friction-stage}
# Commands end with 3 where there is something to warn of.
warned() { "$@" || [ $? -eq 3 ]; }

echo '== a stage with an effect that its declared model lacks, and two recordings of it'
"$fs" demo recordings --out "$out" --seed "${2:-1}" ${3:+--hide "$3"}
echo '== what the recordings show'
warned "$fs" identify --model "$out/declared.yaml" --train "$out/train" --holdout "$out/check" --out "$out/identified"
echo '== gains for the identified stage'
warned "$fs" tune "$out/identified/identified.yaml" --application "$here/../../launch_config/application_fast_move_clean.yaml" --out "$out/tuning"
echo '== the real stage without and with the compensation of the declared model, then of the identified one'
"$fs" demo recordings --out "$out" --reveal --json > "$out/real.yaml"
for model in "$out/declared.yaml" "$out/identified/identified.yaml"; do
    name=$(basename "$model" .yaml)
    warned "$fs" compensate --model "$model" --real "$out/real.yaml" --controller "$out/tuning/controller.yaml" "$here/moves.yaml" --out "$out/with_$name"
done
