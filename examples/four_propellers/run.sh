#!/bin/sh
# From raw bags to a report page: sh run.sh [DIR] [SECONDS]
set -eu
lab=$(cd "$(dirname "$0")" && pwd)
out=${1:-four_propellers}
# In place of two flights; a lab has its bags already.
[ -d "$out/training" ] || python "$lab/make_bags.py" "$out" "${2:-60}"

set -- --vehicle "$lab/vehicle.toml" --mapping "$lab/mapping.toml"
airpuck check "$out/training" "$@"
airpuck identify "$out/training" "$@" --validation "$out/validation" --report "$out/report" -o "$out/model.toml"
echo "The page is $out/report/index.html"
