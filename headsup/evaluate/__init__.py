"""`headsup evaluate`: figures that prove things, made anew from data and from the simulator."""
