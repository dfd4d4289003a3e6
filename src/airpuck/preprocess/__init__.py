"""Recording -> trajectory."""
