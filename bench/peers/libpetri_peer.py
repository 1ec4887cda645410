"""libpetri: each transition calls a Python function that counts and passes the token on; compiled, events stored."""

import libpetri
from serve import serve


def load(net):
    """Compiles a net."""
    places = {name: libpetri.Place(name) for name in net["places"]}
    initial = {places[name]: ["token"] * tokens for name, tokens in net["places"].items() if tokens}
    calls, limit = [0], [0]
    builder = libpetri.Net("net")
    for name, (inputs, outputs) in net["transitions"].items():
        transition = libpetri.Transition(name)
        for place in inputs:
            transition = transition.input(libpetri.one(places[place]))
        given = [libpetri.out(places[place]) for place in outputs]
        transition = transition.output(given[0] if len(given) == 1 else libpetri.and_(*given))
        builder = builder.transition(transition.action(_action(inputs, outputs, calls, limit)).build())
    compiled = libpetri.compile(builder.build())
    # What an action puts out is not checked against the net: the faster of its two ways.
    options = libpetri.ExecutorOptions(skip_output_validation=True)

    def fire(firings):
        calls[0], limit[0] = 0, firings
        compiled.run_sync(initial=initial, options=options, event_store=libpetri.InMemoryEventStore())
        return calls[0]

    return fire


def _action(inputs, outputs, calls, limit):
    """Returns the action of a transition; it gives no token when the limit is reached, which ends the run."""
    source = inputs[0]
    if len(outputs) == 1:
        target = outputs[0]

        def pass_on(ctx):
            calls[0] += 1
            if calls[0] < limit[0]:
                ctx.output(target, ctx.input(source))
    else:

        def pass_on(ctx):
            calls[0] += 1
            if calls[0] < limit[0]:
                token = ctx.input(source)
                for target in outputs:
                    ctx.output(target, token)

    return pass_on


if __name__ == "__main__":
    serve(load)
