"""What tests of air hockey share."""
