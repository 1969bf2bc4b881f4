"""What single procedures are made of: driving, fits, tables and figures.

`headlines` serves all of them; the other modules begin with the first word of the procedure that they belong
to. What any procedure can use is in `hil.procedure`. Nothing here imports a procedure.
"""
