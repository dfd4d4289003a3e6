#!/bin/sh
# From the download to the table: sh run.sh [OUTPUT] [FOLDER]
# FOLDER is the dataset's folder; intact files in it are not downloaded again.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
out=${1:-cybership_enterprise}
data=${2:-$out/data}
airpuck fetch cybership-enterprise -o "$data"
python "$here/convert.py" "$data" "$data/runs"

for model in M3+drag M3+hull; do
    airpuck identify "$data/runs/run1.csv" --vehicle "$data/vehicle.toml" --mapping "$data/mapping.toml" \
        --model "$model" --encoder-time 1 --prediction-time 3 --stride 10 --quiet -o "$out/$model.toml" > /dev/null || true
done
python "$here/table.py" "$data" "$out/M3+drag.toml" "$out/M3+hull.toml"
