#!/usr/bin/env bash
# Expected: a line that begins with `#` in the exporter's YAML file is a comment, as in the environment file.
# Version: labgrid 26.0.1
# So it is: the file is a Jinja template first, with `#` as the prefix of a line statement. The comment ends the
#   exporter with a syntax error of the template, which names a word of the comment and not the file's language.
# Source: code, labgrid/remote/config.py, ResourceConfig; seen 2026-11-29 with CPython 3.11
# What to do: write `## comment` or `{# comment #}`, which the template takes out.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet labgrid==26.0.1
cat > exporter.yaml <<'YAML'
# the bench of our lab
bench:
  NetworkService:
    address: 127.0.0.1
    username: someone
YAML
sed 's/^# /## /' exporter.yaml > two_signs.yaml
venv/bin/python - <<'PY'
import contextlib
import io

from labgrid.remote.config import ResourceConfig

def read(name):
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            return dict(ResourceConfig(name).data["bench"]["NetworkService"])
        except Exception as error:
            return f"{type(error).__name__}: {error}"

one, two = read("exporter.yaml"), read("two_signs.yaml")
print("# ...: ", one)
print("## ...:", two)
assert one == "TemplateSyntaxError: Encountered unknown tag 'the'."
assert two == {"address": "127.0.0.1", "username": "someone"}
PY
echo "still so"
