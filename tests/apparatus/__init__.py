"""What the tests are made with: each module says what it makes, or what it checks."""
