"""What the cell has once, and commands that take it: the resource net ``cell``, and the line in which commands wait.

``resources`` names what there is, ``needs`` what each command takes, ``net`` makes the net of it, ``line`` says whose
turn it is.
"""
