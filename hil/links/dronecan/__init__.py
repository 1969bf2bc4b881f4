"""The few DroneCAN messages that keep a fan running."""
