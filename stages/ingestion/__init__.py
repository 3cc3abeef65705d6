"""From files' tables to points and configurations in the contract's units, checked."""
