"""Give the Dispatcher a command of your own: verified before it is live, watched while it runs, and taken out again."""

from im import Machine

NET = """
net: greet
commands: {greet: {description: Says hello.}}
places: {idle: {tokens: 1, resource: true}, greeted: }
transitions:
  go: {symbol: greet, in: idle, out: greeted}
  tell: {in: greeted, out: idle, emit: greet_done}
"""

with Machine.connect() as im:
    print(im.load_net(NET))
    with im.firings("greet") as firings:
        im.run("greet")
        print("fired:", firings.next(timeout=10).transition)
    im.unload_net("greet")
