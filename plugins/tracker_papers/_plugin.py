"""The component records of the papers' scenarios; nothing heavy is imported here."""

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Offer the scenarios of this package."""
    registry.add(
        Component(
            kind="scenario",
            name="two_stations",
            target="tracker_papers.two_stations:two_stations",
            summary="A ship seen from two fixed stations by azimuth alone.",
            paper="0",
            equations=("26-31", "34", "35"),
            tags=("passive", "bearings", "2-D"),
        )
    )
    registry.add(
        Component(
            kind="scenario",
            name="line",
            target="tracker_papers.line:line",
            summary="A target on a line, its position measured: linear and Gaussian.",
            paper="Särkkä 2013",
            equations=("example 4.3",),
            tags=("linear", "1-D"),
        )
    )
    registry.add(
        Component(
            kind="scenario",
            name="moving_observer",
            target="tracker_papers.moving_observer:moving_observer",
            summary="Bearings only from one observer that goes straight, or manoeuvres.",
            paper="2",
            equations=("9-12",),
            tags=("passive", "bearings", "2-D", "observability"),
        )
    )
    registry.add(
        Component(
            kind="scenario",
            name="gulf_to_oman",
            target="tracker_papers.gulf_to_oman:gulf_to_oman",
            summary="A ship from the Persian Gulf to the Sea of Oman, its azimuth from two stations.",
            paper="0",
            equations=("26-31", "34", "35", "figures 2, 4-6"),
            tags=("passive", "bearings", "2-D", "manoeuvre"),
            examples=("gulf_to_oman('B')",),
        )
    )
    registry.add(
        Component(
            kind="scenario",
            name="turning_target",
            target="tracker_papers.turning_target:turning_target",
            summary="An aircraft that turns at an unknown rate; range and azimuth.",
            paper="Arasaratnam and Haykin 2009",
            equations=("section VIII.A",),
            tags=("nonlinear", "2-D", "manoeuvre"),
        )
    )
    registry.add(
        Component(
            kind="scenario",
            name="reentry",
            target="tracker_papers.reentry:reentry",
            summary="A body that enters the atmosphere; range and azimuth.",
            paper="Julier and Uhlmann 2004",
            equations=("section VI",),
            tags=("nonlinear", "2-D"),
        )
    )
    registry.add(
        Component(
            kind="scenario",
            name="growth",
            target="tracker_papers.growth:growth",
            summary="The univariate growth model: two modes, of which a Gaussian sees one.",
            paper="Gordon, Salmond and Smith 1993",
            equations=("section 5.1",),
            tags=("nonlinear", "1-D"),
        )
    )
    registry.add(
        Component(
            kind="scenario",
            name="flying_object",
            target="tracker_papers.flying_object:flying_object",
            summary="Three linear states and a filter that is told the wrong R, or the wrong Q.",
            paper="4",
            equations=("3-11", "3-12"),
            tags=("linear", "wrong noise"),
            examples=("flying_object('Q')",),
        )
    )
    registry.add(
        Component(
            kind="scenario",
            name="underwater_multipath",
            target="tracker_papers.underwater_multipath:underwater_multipath",
            summary="A target under water by the delays of its echoes at two hydrophones; wrong R.",
            paper="4",
            equations=("4-9 to 4-14", "4-34 to 4-38"),
            tags=("passive", "delays", "3-D", "wrong noise"),
            examples=("underwater_multipath('printed')",),
        )
    )
    registry.add(
        Component(
            kind="scenario",
            name="underwater_angles",
            target="tracker_papers.underwater_angles:underwater_angles",
            summary="A target under water by azimuth and elevation from two sensors; wrong R.",
            paper="4",
            equations=("5-1 to 5-20",),
            tags=("passive", "angles", "3-D", "wrong noise"),
            examples=("underwater_angles('manoeuvring')",),
        )
    )
    registry.add(
        Component(
            kind="reproduction",
            name="paper_0",
            target="tracker_papers.paper0.study:PaperZero",
            summary="EKF1, EKF2 and UKF with RTS smoothing: Table 1, figures 1-11, six claims, errata.",
            paper="0",
            equations=("Table 1", "figures 1-11"),
            tags=("paper",),
            requires={"matplotlib": "tracker-lab[plot]"},
        )
    )
    registry.add(
        Component(
            kind="reproduction",
            name="paper_4",
            target="tracker_papers.paper4.study:PaperFour",
            summary="Fuzzy noise adaptation tuned by GA, PSO, ICA: Tables 3-1 to 5-3, figures, seven claims.",
            paper="4",
            equations=("Tables 3-1 to 3-4, 4-1, 5-1 to 5-3", "figures 3-7 to 5-33"),
            tags=("paper",),
            requires={"matplotlib": "tracker-lab[plot]"},
        )
    )
