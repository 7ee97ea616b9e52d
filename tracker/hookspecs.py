"""The one hook by which a plugin makes its components known: its markers and its reference manual.

No mechanism belongs here; discovery, failure policy and look-up are in ``tracker.registry``.

A plugin is a module named by an entry point of the group ``tracker.plugins``::

    # pyproject.toml of the plugin
    [project.entry-points."tracker.plugins"]
    sonar = "tracker_sonar._plugin"

    # tracker_sonar/_plugin.py: imports nothing heavy, so that listing every component stays cheap
    from tracker.hookspecs import hookimpl
    from tracker.registry import Component, Registry

    @hookimpl
    def tracker_components(registry: Registry) -> None:
        registry.add(
            Component(
                kind="sensor",
                name="depression_angle",
                target="tracker_sonar.depression:DepressionAngle",
                summary="angle below the horizon seen from a towed array",
                paper="Author, Title, 2020",
                equations=("(3)", "(7)"),
                tags=("passive", "angle"),
            )
        )
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pluggy

if TYPE_CHECKING:
    from tracker.registry import Registry

__all__ = ["hookimpl", "hookspec", "tracker_components"]

hookspec = pluggy.HookspecMarker("tracker")
hookimpl = pluggy.HookimplMarker("tracker")


@hookspec
def tracker_components(registry: Registry) -> None:
    """Add the plugin's components, by ``registry.add(Component(...))``, once per component.

    The hook is called once, when the plugin is discovered. What it adds becomes visible after it
    has returned, all of it or, if it raises, none of it; the framework then records the plugin as
    failed and goes on with the next one. The hook therefore needs no error handling of its own.

    ``registry`` takes components only: those of other plugins are not in it, and neither the hook nor
    the import of the plugin may ask ``tracker.registry.default_registry()`` for them. The origin of
    a component (distribution and version) is filled in by the framework.
    """
