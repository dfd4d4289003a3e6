#!/bin/sh
# From the download to a report page: sh run.sh [OUTPUT] [FOLDER]
# FOLDER is the dataset's folder; intact files in it are not downloaded again.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
out=${1:-air_bearing_satellite}
data=${2:-$out/data}
airpuck fetch air-bearing-satellite -o "$data"

flight="$data/Data/Real_Test/Test/real_test_data.csv"
set -- --vehicle "$data/vehicle.toml" --mapping "$data/mapping.toml"
# The exit status is 2, because the recording disagrees with the vehicle file about a thruster.
airpuck check "$flight" "$@" || true

airpuck identify "$flight" "$@" --report "$out/report" -o "$out/whole.toml"
airpuck identify "$flight" "$@" --span 0 0.6 --quiet -o "$out/start.toml" > /dev/null
python "$here/table.py" "$data" "$out/whole.toml" "$out/start.toml"
echo "The page is $out/report/index.html"
