"""The commands of this distribution; `ninedtact` finds them by their entry points."""
