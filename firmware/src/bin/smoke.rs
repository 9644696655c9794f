//! The smallest application that uses every part of a board: it shows that clocks, timer, CAN and logs
//! work before any protocol runs.
//!
//! The measuring point `calendar` changes every millisecond. Every 10 ms one soft real-time frame is sent
//! with a running number; what comes in is logged.
#![no_std]
#![no_main]

use cosmic_rtt as _;

#[rtic::app(device = boards::pac, dispatchers = [SPI1, SPI2])]
mod app {
    use boards::bxcan_rx::{FIFO_DEPTH, RxFrames};
    use boards::bxcan_tx::{SoftMailbox, TxOutcomes};
    use boards::clock;
    use boards::stm32f4::{MeasuringPoint, Settings};
    use cosmic_core::can::filter_banks::{Fifo, FilterBank};
    use cosmic_core::can::{BitRate, Etag, Frame, Id, Mailbox, Payload, Priority, TxNode};
    use cosmic_core::time::Duration;
    use firmware::vehicle::Board;

    /// Hard real-time frames into the urgent FIFO, and all others into the other one.
    const FILTERS: [FilterBank; 2] = [
        FilterBank::Mask { fifo: Fifo::Urgent, id: 0, mask: 0xFF << 21 },
        FilterBank::Mask { fifo: Fifo::Other, id: 0, mask: 0 },
    ];

    #[shared]
    struct Shared {
        soft_is_empty: bool,
    }

    #[local]
    struct Local {
        point: MeasuringPoint<12>,
        soft: SoftMailbox,
        outcomes: TxOutcomes,
        urgent: RxFrames,
        other: RxFrames,
    }

    #[init]
    fn init(context: init::Context) -> (Shared, Local) {
        firmware::records::start(5);
        let settings = Settings { bit_rate: BitRate::MAX, filters: FILTERS.iter(), leaves_spare: false };
        let Ok(board) = Board::new(boards::resources!(context.device), settings, 5) else {
            defmt::panic!("the settings ask for what the board cannot do");
        };
        let points = defmt::unwrap!(board.points);
        defmt::info!("smoke: up");
        let _ = blink::spawn();
        let _ = send::spawn();
        (
            Shared { soft_is_empty: true },
            Local {
                point: points.calendar,
                soft: board.soft,
                outcomes: board.outcomes,
                urgent: board.urgent,
                other: board.other,
            },
        )
    }

    #[task(local = [point], priority = 2)]
    async fn blink(context: blink::Context) {
        let mut next = clock::now();
        loop {
            next = next + Duration::from_millis(1);
            clock::delay_until(next).await;
            context.local.point.toggle();
        }
    }

    #[task(local = [soft], shared = [soft_is_empty], priority = 1)]
    async fn send(mut context: send::Context) {
        let id = Id::new(Priority::SOFT_MOST_URGENT, TxNode::MIN, Etag::BOUND_LAST);
        let mut next = clock::now();
        let mut number: u32 = 0;
        loop {
            next = next + Duration::from_millis(10);
            clock::delay_until(next).await;
            let is_empty = context.shared.soft_is_empty.lock(core::mem::take);
            if is_empty {
                let payload = Payload::new(&number.to_be_bytes()).unwrap_or(Payload::EMPTY);
                context.local.soft.load(&Frame::new(id, payload));
            } else {
                defmt::warn!("frame {} was not sent: the mailbox is not empty", number);
            }
            number = number.wrapping_add(1);
        }
    }

    #[task(binds = CAN1_TX, local = [outcomes], shared = [soft_is_empty], priority = 4)]
    fn can_tx(mut context: can_tx::Context) {
        while let Some((mailbox, outcome)) = context.local.outcomes.take() {
            defmt::debug!("{}: {}", mailbox, outcome);
            if mailbox == Mailbox::Soft {
                context.shared.soft_is_empty.lock(|is_empty| *is_empty = true);
            }
        }
    }

    #[task(binds = CAN1_RX0, local = [urgent], priority = 5)]
    fn can_rx_urgent(context: can_rx_urgent::Context) {
        for _ in 0..FIFO_DEPTH {
            let Some(frame) = context.local.urgent.read() else { break };
            defmt::info!("hard real-time {}", frame);
        }
    }

    #[task(binds = CAN1_RX1, local = [other], priority = 3)]
    fn can_rx_other(context: can_rx_other::Context) {
        for _ in 0..FIFO_DEPTH {
            let Some(frame) = context.local.other.read() else { break };
            defmt::info!("received {}", frame);
        }
    }
}
