"""What the procedures are made of: driving, arrays from records, fits, tables and figures.

`samples`, `scripted`, `tracking`, `devices`, `fragment` and `workers` serve several procedures; the others
begin with the first word of the one that they belong to. Nothing here knows a procedure.
"""
