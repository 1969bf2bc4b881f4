"""Real drivers; the same code talks to hardware and to emulated devices."""
