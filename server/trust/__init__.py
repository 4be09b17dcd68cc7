"""Who is let in: keys, rates, security headers."""
