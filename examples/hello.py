"""Connect to a running machine, and print what it is and can do."""

from im import Machine

with Machine.connect() as im:
    print("motion control:", im.state.state)
    for group in im.state.groups:
        print(f"group {group.group}: {group.state}, owner {group.owner or 'nobody'}")
    for name, command in im.commands.items():
        print(f"{name}: {command['description']}")
