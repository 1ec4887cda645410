"""Check of requests between nets for the needed arguments, as far as the files say."""

from collections.abc import Sequence

from im_core.errors import DataError
from im_pnt.errors import NetError
from im_pnt.expression.scope import NetScope, PlacedError, check_value
from im_pnt.expression.template import has_expressions
from im_pnt.expression.types import NoTypes, argument_type
from im_pnt.model.action import RequestAction
from im_pnt.model.arguments import ArgumentSchema
from im_pnt.model.net import Net, Transition


def check_arguments(nets: Sequence[Net]) -> None:
    """Check the requests of nets to each other.

    Raises:
        NetError: A request brings an argument that its service does not know, or that does not fit, or lacks one.
    """
    by_name = {net.name: net for net in nets}
    for net in nets:
        scope = NetScope(net, NoTypes())
        for transition in net.transitions.values():
            action = transition.action
            if not isinstance(action, RequestAction) or action.net not in by_name:
                continue
            schema = by_name[action.net].arguments_of(action.service)
            if schema is None:
                continue
            try:
                _check_request(scope, transition, action, schema)
            except DataError as error:
                where = net.place_of(transition)
                name = transition.origin or transition.name
                text = f"{where}transition {name} of net {net.name} asks for what is refused: {error.message}"
                raise NetError(text, **error.facts) from error


def _check_request(scope: NetScope, transition: Transition, action: RequestAction, schema: ArgumentSchema) -> None:
    what = f"{action.net}.{action.service}"
    if action.build is None and not action.fields:
        _check_passed_on(scope, transition, schema, what)
        return
    schema.require_known(action.fields, what)
    for name, value in action.fields.items():
        if not has_expressions(value):
            schema.arguments[name].check(value)
            continue
        wanted = argument_type(schema.arguments[name])
        try:
            check_value(value, wanted, scope.meanings(transition))
        except PlacedError as error:
            raise DataError(f"{what}: argument {name}: {error.sentence}", argument=name) from error
    if action.build is None:
        schema.require_given(action.fields, what)


def _check_passed_on(scope: NetScope, transition: Transition, schema: ArgumentSchema, what: str) -> None:
    """Check a request without arguments: the arguments of the command or request in work are passed on."""
    for kind in sorted(scope.works_for(transition)):
        given = scope.net.arguments_of(kind)
        if given is None:
            continue
        about = f"{what}, to which the arguments of {kind} are passed on,"
        schema.require_known(given.arguments, about)
        schema.require_given(given.arguments, about)
        for name, argument in given.arguments.items():
            if not argument_type(argument).fits(wanted := argument_type(schema.arguments[name])):
                sentence = f"{about} asks for {name} as {wanted}; it is {argument_type(argument)}"
                raise DataError(sentence, argument=name)
