"""What runs in the peers' processes, by Pythons that need not have fibercontact."""
