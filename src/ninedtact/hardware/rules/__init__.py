"""What a design must keep to be built; each rule has a name, and a broken one says how to mend it."""
