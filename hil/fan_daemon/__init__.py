"""The fan daemon: a small process of its own that goes on commanding the fan when everything else dies.

`fan_control` decides what to send, `bus_cycle` sends it, `server` is the socket, `process` the process,
`standby` the second process that takes over when the first dies, `client` finds or starts the daemon,
`failover` lets a bench command the fan while there is neither. Nothing here imports more than python-can
and the standard library: what is not loaded cannot fail.
"""
