#!/bin/sh
# From a doubt to the model beside the stage. Each recording is made over ROS 2, by stage_node and
# controller_node in lockstep.
# usage: examples/closing_the_loop/run.sh [DIRECTORY FOR THE RESULTS]
set -eu
here=$(cd "$(dirname "$0")" && pwd)
declared=$here/../../launch_config/stage_measured_runs.yaml
out=${1:-closing_the_loop}
fs=${FRICTION_STAGE:-friction-stage}
# identify ends with 3 where there is something to warn of.
warned() { "$@" || [ $? -eq 3 ]; }
limits='--stroke -0.03 0.03 --max-speed 0.5 --max-force 800 --max-duration 6'

echo '== a first recording, of slow moves, and one to hold out'
"$fs" play "$here/slow_moves.yaml" --model "$here/real.yaml" --rate 2000 --record "$out/first"
"$fs" play "$here/slow_moves_to_check.yaml" --model "$here/real.yaml" --rate 2000 --record "$out/first_check"
echo '== the doubt, and the motion that settles it'
# shellcheck disable=SC2086
warned "$fs" identify --model "$declared" --train "$out/first" --holdout "$out/first_check" --out "$out/doubt" --next-experiment $limits
echo '== that motion on the stage, and once more, slower, to hold out'
"$fs" play "$out/doubt/next_experiment.yaml" --model "$here/real.yaml" --rate 2000 --record "$out/second"
"$fs" play "$out/doubt/next_experiment.yaml" --model "$here/real.yaml" --rate 2000 --record "$out/third" --stretch 1.25 --seed 2
warned "$fs" identify --model "$declared" --train "$out/first" "$out/second" --holdout "$out/third" --out "$out/settled"
echo '== the declared and the identified model on the recording that no fit has seen'
"$fs" replay "$out/third" --model "$declared"
"$fs" replay "$out/third" --model "$out/settled/identified.yaml"
