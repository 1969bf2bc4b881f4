"""Files of motion capture systems and trajectory tools: poses of bodies, and no wheels."""
