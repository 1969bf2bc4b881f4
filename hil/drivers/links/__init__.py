"""What drivers of sensors that send unasked have in common: ports, packets, stamps, silence."""
