"""The fan's keeper: a small process of its own that goes on commanding the fan when everything else dies.

`core` decides what to send, `beat` sends it, `door` is the socket, `process` the process, `understudy` the
one that goes on when it is gone, `client` how others find and start it, `deputy` how a bench stands in for
both. Nothing here imports more than python-can and the standard library: what is not loaded cannot fail.
"""
