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
    if ! hil run "$procedure" --bench bench.toml --emulate all --out "$out"; then
        failed=1
        [ -z "${GITHUB_ACTIONS:-}" ] || echo "::error file=$procedure::$procedure has not passed: see $out/report.html"
    fi
done
exit $failed
