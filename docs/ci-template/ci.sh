#!/bin/sh
# Everything emulated, in virtual time: needs no hardware and takes about a minute.
set -eu
rm -rf results
mkdir results
python -m pytest --junitxml=results/tests.xml
hil run procedures/short_line.py --bench bench.toml --emulate all --out results/short_line
