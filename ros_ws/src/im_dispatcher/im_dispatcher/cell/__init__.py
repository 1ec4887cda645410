"""Resources of the cell, and the commands that take them: the resource net ``cell``, and the queue of commands.

``resources`` names what there is, ``needs`` what each command takes, ``net`` makes the net of it, ``line`` says whose
turn it is.
"""
