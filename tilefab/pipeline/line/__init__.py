"""A factory line at work: the daemon that drives printer, conveyor and kiln, and what it tells of itself.

`daemon` holds the state machine of `tilefab.control.line_machine` between the loops of the devices (`printer_loop`,
`conveyor_loop`, `kiln_loop`, each kept connected by a `device_link`); `bring_up` finds out what became of every face
before anything moves; `source` and `streaming` send faces strip by strip; `keeper` writes the journal in a thread of
its own. `orders` are what an operator may ask for; `status`, `alarms`, `metrics`, `log` and `watchdog` tell people and
machines how the line is doing.
"""
