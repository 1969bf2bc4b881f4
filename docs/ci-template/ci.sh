#!/bin/sh
# Everything emulated, in virtual time: needs no hardware and takes about a minute.
# What a failed test has recorded is kept in results/failed, with a page.
set -u
rm -rf results
mkdir results
failed=0
python -m pytest --junitxml=results/tests.xml --hil-keep results/failed || failed=1
for procedure in procedures/*.py; do
    out=results/$(basename "$procedure" .py)
    if ! hil run "$procedure" --bench bench.toml --emulate all --out "$out" \
        > results/said.txt 2> results/errors.txt; then
        failed=1
        why="$procedure has not passed: see $out/report.html"
        [ -e "$out/report.html" ] || why=$(tail -n 1 results/errors.txt | sed 's/%/%25/g')
        [ -z "${GITHUB_ACTIONS:-}" ] || echo "::error file=$procedure::$why"
    fi
    cat results/errors.txt >&2
    cat results/said.txt
    rm results/errors.txt results/said.txt
done
exit $failed
