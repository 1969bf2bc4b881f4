#!/usr/bin/env bash
# Expected: with `--reruns`, each attempt is a case of its own in JUnit XML, and the case of the attempt that passed has
#   the properties of that attempt.
# Version: pytest-rerunfailures 16.7, pytest 9.2.0
# So it is: the case of the passed attempt also has the properties of the failed one, and has them first: who reads the
#   first value of a name reads the failed attempt's.
# Source: code, pytest_rerunfailures.py (`item.user_properties` is never emptied); seen 2026-11-29 with CPython 3.11
# What to do: read the last property of a name; in a plugin, take your own out of `item.user_properties` where an
#   attempt begins (`pytest_runtest_setup`).
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet pytest==9.2.0 pytest-rerunfailures==16.7
cat > test_rig.py <<'PY'
ATTEMPTS = []

def test_motor(record_property):
    ATTEMPTS.append(1)
    record_property("held", "no" if len(ATTEMPTS) == 1 else "yes")
    assert len(ATTEMPTS) == 2
PY
venv/bin/python -m pytest -q --reruns 1 --junitxml=junit.xml -o junit_family=xunit1
venv/bin/python - <<'PY'
from xml.etree import ElementTree

found = [
    [one.get("value") for one in case.iter("property")] for case in ElementTree.parse("junit.xml").iter("testcase")
]
print("`held` of each case:", found)
assert found == [["no"], ["no", "yes"]]
PY
echo "still so"
