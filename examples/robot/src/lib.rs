//! What the nodes of the robot share: the plan, and the contents of its channels.
#![no_std]

use boards::Stm32F405;
use cosmic_core::event_layer::Channel;
use cosmic_core::services::ClockService;

use plan::channels;

// What `cosmic-plan` makes of cluster.toml: the module `plan`.
cosmic_core::include_plan!();

/// What a node of the robot is made of.
pub struct Robot;

impl cosmic_rtic::System for Robot {
    type Board = Stm32F405;
    type Capacity = plan::Capacities;
    type Services = ClockService;
    type Observer = ();
}

cosmic_core::content! {
    /// Where the joint is, in thousandths of a degree.
    #[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
    pub struct JointAngle {
        pub millidegrees: i32,
    }
}

cosmic_core::content! {
    /// Where the joint is to go.
    #[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
    pub struct SetPoint {
        /// In thousandths of a degree.
        pub millidegrees: i32,
        /// In hundredths of a degree per second.
        pub speed: i16,
    }
}

cosmic_core::content! {
    /// How hot the motor is, in hundredths of a degree Celsius.
    #[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
    pub struct MotorHeat {
        pub centidegrees: i16,
    }
}

pub const JOINT_ANGLE: Channel<JointAngle> = channels::joint_angle::channel();
pub const SET_POINT: Channel<SetPoint> = channels::set_point::channel();
pub const MOTOR_HEAT: Channel<MotorHeat> = channels::motor_heat::channel();
