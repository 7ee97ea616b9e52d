"""The component records of Kalman-type filters and smoothers; nothing heavy is imported here."""

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Offer the filters and smoothers of this package."""
    registry.add(
        Component(
            kind="filter",
            name="kf",
            target="tracker_kalman.kf:KalmanFilter",
            summary="Kalman filter for linear models, whitened update.",
            paper="4",
            equations=("2-5", "2-6", "2-7", "2-8", "2-9", "2-13", "2-14", "2-15"),
            tags=("gaussian", "linear", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ekf1",
            target="tracker_kalman.ekf1:ExtendedKalmanFilter",
            summary="First-order extended Kalman filter, whitened update.",
            paper="0",
            equations=("6", "7", "8", "31"),
            tags=("gaussian", "nonlinear", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ekf2",
            target="tracker_kalman.ekf2:SecondOrderExtendedKalmanFilter",
            summary="Second-order extended Kalman filter, complete innovation covariance.",
            paper="0",
            equations=("9", "10", "11", "33"),
            tags=("gaussian", "nonlinear", "second-order", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="iekf",
            target="tracker_kalman.iterated:IteratedExtendedKalmanFilter",
            summary="Iterated extended Kalman filter, Gauss-Newton steps of fixed number.",
            paper="Bell and Cathey, The iterated Kalman filter update as a Gauss-Newton method, 1993",
            tags=("gaussian", "nonlinear", "iterated", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="information",
            target="tracker_kalman.information:InformationFilter",
            summary="Information filter on linear and linearised models; may start from nothing.",
            paper="Maybeck, Stochastic Models, Estimation and Control 1, 1979",
            equations=("section 5.7",),
            tags=("gaussian", "nonlinear", "information", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="schmidt",
            target="tracker_kalman.schmidt:SchmidtFilter",
            summary="Schmidt-Kalman filter: biases that are considered, not estimated, in any Gaussian filter.",
            paper="Schmidt, Application of state-space methods to navigation problems, 1966",
            equations=("Simon 2006, section 10.3.2",),
            tags=("gaussian", "nonlinear", "bias", "composition", "traced"),
            examples=("schmidt(considered=['bias'], inner='ekf1')",),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="huber",
            target="tracker_kalman.huber:HuberUpdate",
            summary="Any Gaussian filter whose update bounds the pull of outliers (Huber's cost).",
            paper="Karlgaard and Schaub, Huber-based divided difference filtering, 2007",
            tags=("gaussian", "nonlinear", "robust", "composition", "traced"),
            examples=("huber(inner='ukf', threshold=1.345)",),
            deviations={
                "equals the textbook filter": "a measurement far from the prediction is trusted less: "
                "that is its purpose; with a large threshold the law holds",
                "one measurement at a time": "what an earlier component has explained changes what "
                "counts as far for a later one",
            },
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="student_t",
            target="tracker_kalman.student_t:StudentTUpdate",
            summary="Any Gaussian filter with measurement noise of Student's t: outliers are left out.",
            paper="Agamennoni, Nieto and Nebot, Inference in models with heavy-tailed noise, 2012",
            equations=("Piché, Särkkä and Hartikainen 2012",),
            tags=("gaussian", "nonlinear", "robust", "composition", "traced"),
            examples=("student_t(inner='ekf2', degrees_of_freedom=4.0)",),
            deviations={
                "equals the textbook filter": "its noise is not Gaussian: every residual changes what "
                "a measurement is worth; with many degrees of freedom the law holds",
                "subtracts through the residual": "the residual is wrapped, but the step is not that of "
                "Gaussian noise, which the law expects",
                "one measurement at a time": "one weight serves all components measured together",
            },
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="square_root",
            target="tracker_kalman.square_root:SquareRootFilter",
            summary="First-order extended Kalman filter that carries a root of the covariance.",
            paper="Kaminski, Bryson and Schmidt, Discrete square root filtering, 1971",
            tags=("gaussian", "nonlinear", "square-root", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ekf1_joseph",
            target="tracker_kalman.joseph:JosephFilter",
            summary="First-order extended Kalman filter, Joseph form of the covariance.",
            paper="Bar-Shalom, Li and Kirubarajan 2001",
            equations=("5.2.3-18",),
            tags=("gaussian", "nonlinear", "traced"),
        )
    )
    registry.add(
        Component(
            kind="smoother",
            name="rts",
            target="tracker_kalman.rts:RauchTungStriebel",
            summary="Rauch-Tung-Striebel fixed-interval smoother.",
            paper="0",
            equations=("24",),
            tags=("gaussian", "fixed-interval", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ukf",
            target="tracker_kalman.sigma_point:unscented",
            summary="Unscented Kalman filter with scaled points; options alpha, beta, kappa.",
            paper="2",
            equations=("23", "24", "25", "26", "27", "28", "29", "30"),
            tags=("gaussian", "nonlinear", "sigma points", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ukf_symmetric",
            target="tracker_kalman.sigma_point:unscented_symmetric",
            summary="Unscented Kalman filter with 2n equal points and no centre.",
            paper="0",
            equations=("12", "13", "14", "15", "16", "17", "18", "19", "20", "21", "22", "23"),
            tags=("gaussian", "nonlinear", "sigma points", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ukf_general",
            target="tracker_kalman.sigma_point:unscented_general",
            summary="The original unscented Kalman filter; kappa is 3 - n unless given.",
            paper="Julier, Uhlmann and Durrant-Whyte 2000",
            equations=("12",),
            tags=("gaussian", "nonlinear", "sigma points", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ukf_spherical_simplex",
            target="tracker_kalman.sigma_point:unscented_spherical_simplex",
            summary="Unscented Kalman filter with n + 1 points on a sphere.",
            paper="Julier 2003",
            tags=("gaussian", "nonlinear", "sigma points", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ukf_minimal_simplex",
            target="tracker_kalman.sigma_point:unscented_minimal_simplex",
            summary="Unscented Kalman filter with n + 1 points of minimal skew.",
            paper="Julier and Uhlmann 2002",
            tags=("gaussian", "nonlinear", "sigma points", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ckf",
            target="tracker_kalman.sigma_point:cubature",
            summary="Cubature Kalman filter of third degree.",
            paper="Arasaratnam and Haykin 2009",
            equations=("36",),
            tags=("gaussian", "nonlinear", "sigma points", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ckf5",
            target="tracker_kalman.sigma_point:cubature_degree_5",
            summary="Cubature Kalman filter of fifth degree.",
            paper="Jia, Xin and Cheng 2013",
            equations=("41",),
            tags=("gaussian", "nonlinear", "sigma points", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ghkf",
            target="tracker_kalman.sigma_point:gauss_hermite",
            summary="Gauss-Hermite Kalman filter of any order.",
            paper="Ito and Xiong 2000",
            tags=("gaussian", "nonlinear", "sigma points", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ukf_square_root",
            target="tracker_kalman.square_root_sigma_point:SquareRootSigmaPointFilter",
            summary="Sigma-point Kalman filter on square roots; any set of points.",
            paper="Van der Merwe and Wan 2001",
            tags=("gaussian", "nonlinear", "sigma points", "square root", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="iplf",
            target="tracker_kalman.posterior_linearisation:PosteriorLinearisationFilter",
            summary="Iterated posterior linearisation filter; any set of points.",
            paper="García-Fernández, Svensson, Morelande and Särkkä 2015",
            equations=("algorithm 1",),
            tags=("gaussian", "iterated", "nonlinear", "sigma points", "traced"),
        )
    )
    registry.add(
        Component(
            kind="smoother",
            name="sigma_point_rts",
            target="tracker_kalman.sigma_point_rts:SigmaPointRauchTungStriebel",
            summary="Rauch-Tung-Striebel smoother with gains from sigma points.",
            paper="Särkkä 2008",
            tags=("gaussian", "fixed-interval", "sigma points", "traced"),
        )
    )
    registry.add(
        Component(
            kind="smoother",
            name="square_root_rts",
            target="tracker_kalman.square_root_rts:SquareRootRauchTungStriebel",
            summary="Rauch-Tung-Striebel in square-root form: semi-definite whatever the rounding.",
            paper="Park and Kailath, Square-root RTS smoothing algorithms, 1995",
            tags=("gaussian", "fixed-interval", "square-root", "traced"),
        )
    )
    registry.add(
        Component(
            kind="smoother",
            name="two_filter",
            target="tracker_kalman.two_filter:TwoFilterSmoother",
            summary="Two-filter fixed-interval smoother, its backward filter in information form.",
            paper="Fraser and Potter, The optimum linear smoother as a combination of two optimum "
            "linear filters, 1969",
            equations=("Särkkä 2013, 8.12-8.15",),
            tags=("gaussian", "fixed-interval", "traced"),
        )
    )
    registry.add(
        Component(
            kind="smoother",
            name="fixed_lag",
            target="tracker_kalman.fixed_lag:FixedLagSmoother",
            summary="Fixed-lag smoother: each state given so many more steps; on line, tk.FixedLag.",
            paper="Särkkä, Bayesian Filtering and Smoothing, 2013",
            equations=("section 10.5",),
            tags=("gaussian", "fixed-lag", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="imm",
            target="tracker_kalman.imm:InteractingMultipleModels",
            summary="Interacting multiple models: one filter per mode of a switching motion, mixed.",
            paper="Blom and Bar-Shalom, The interacting multiple model algorithm, 1988",
            equations=("Bar-Shalom, Li and Kirubarajan 2001, section 11.6.6",),
            tags=("manoeuvre", "mixture", "nonlinear", "traced"),
        )
    )
    registry.add(
        Component(
            kind="smoother",
            name="imm_smoother",
            target="tracker_kalman.imm_smoother:ModeSmoother",
            summary="Fixed-interval smoother of interacting multiple models, pair by pair of modes.",
            paper="Helmick, Blair and Hoffman, Fixed-interval smoothing for Markovian switching systems, 1995",
            tags=("fixed-interval", "manoeuvre", "mixture", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="gaussian_sum",
            target="tracker_kalman.gaussian_sum:GaussianSumFilter",
            summary="Gaussian sum: weighted filters side by side, split, pruned and merged.",
            paper="Alspach and Sorenson, Nonlinear Bayesian estimation using Gaussian sum approximations, 1972",
            tags=("mixture", "nonlinear", "traced"),
        )
    )
    registry.add(
        Component(
            kind="function",
            name="two_point",
            target="tracker_kalman.starts:two_point",
            summary="a start from two measurements: place, and velocity by their difference",
            paper="4",
            equations=("2-20 to 2-22",),
            tags=("start",),
        )
    )
    registry.add(
        Component(
            kind="function",
            name="drawn",
            target="tracker_kalman.starts:drawn",
            summary="a start that is as wrong as it says, drawn around the truth",
            paper="4",
            equations=("2-19",),
            tags=("start",),
        )
    )
