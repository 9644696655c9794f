/*
 * COSMIC in C: event channels on the CAN bus, by publish, subscribe, unsubscribe and get_msg.
 *
 * The four calls and msg_obj are named as in Kaiser and Brudna, "A publisher/subscriber architecture supporting
 * interoperability of the CAN-Bus and the Internet", section 4.5; fields and all other calls are this library's own.
 *
 *     ups_node node;
 *     ups_subscription heat;
 *     msg_obj msg;
 *     if (ups_open("can:can0", NULL, &node) != UPS_OK) { fputs(ups_last_error(), stderr); return 1; }
 *     if (subscribe(node, 0x2A, 16, &heat) != UPS_OK) { ... }
 *     while (get_msg(heat, &msg, -1) == UPS_OK) { use(msg.data, msg.length); }
 *
 * Every call may be made by any thread at any time. Handles are numbers that are never used again: one that has been
 * closed gives UPS_ERR_HANDLE. No call may be made in a signal handler, nor in the child of a fork() whose parent has
 * called ups_open().
 *
 * Calls return UPS_OK, or an error below zero; what happened and what to do says ups_last_error(). A result that is
 * returned through a pointer is written on UPS_OK only.
 */
#ifndef UPS_H
#define UPS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Done. */
#define UPS_OK 0
/* A pointer is NULL that must not be, or a value is none. */
#define UPS_ERR_ARGUMENT (-1)
/* There is no such node or subscription (any more). */
#define UPS_ERR_HANDLE (-2)
/* The segment cannot be reached. */
#define UPS_ERR_LINK (-3)
/* No broker has given the node its TxNode, or the channel its etag, within the patience. */
#define UPS_ERR_NOT_BOUND (-4)
/* The node cannot announce or subscribe to the channel: it is hard real-time, contradicts another, or has no room. */
#define UPS_ERR_REFUSED (-5)
/* The content is longer than an event's may be. */
#define UPS_ERR_TOO_LONG (-6)
/* The deadline has passed, or the event expires before it. */
#define UPS_ERR_DEADLINE (-7)
/* The queue towards the bus is full. */
#define UPS_ERR_QUEUE_FULL (-8)
/* Events come more often than the channel's rate says. */
#define UPS_ERR_TOO_FAST (-9)
/* No event has come within the time. */
#define UPS_ERR_TIMEOUT (-10)
/* The subscription was ended while this call waited. */
#define UPS_ERR_CLOSED (-11)
/* A mistake in this library. It can still be used. */
#define UPS_ERR_INTERNAL (-12)

/* Classes of channels, for ups_quality. Hard real-time channels come from the cluster's file, and are received only. */
#define UPS_SOFT 0
#define UPS_NON_REAL_TIME 1
/* Non real-time, and each event is a message of up to UPS_DATA_MAX bytes, in as many frames as it takes. All who use the
   channel say so. */
#define UPS_MESSAGES 2

/* Bytes of an event on a channel that is none of messages, at most. */
#define UPS_EVENT_MAX 8
/* Bytes of a message, at most. */
#define UPS_DATA_MAX 1024
/* Bytes of a link, a path or a name with the zero at its end, at most. */
#define UPS_TEXT_MAX 4096

/* A node on a segment, from ups_open(); never 0. */
typedef uint64_t ups_node;
/* A subscription to a channel, from ups_subscribe(); never 0. */
typedef uint64_t ups_subscription;

/* An event. */
typedef struct msg_obj {
    /* The subject of its channel. */
    uint64_t subject;
    /* To publish: nanoseconds from now until it should have been sent; 0: as the channel says. Received: 0. A message
       has none. */
    uint64_t deadline_ns;
    /* To publish: nanoseconds from now until it is of no use any more; 0: as the channel says. Received: 0. */
    uint64_t validity_ns;
    /* Received: when it arrived, in nanoseconds of CLOCK_MONOTONIC. Not looked at when it is published. */
    uint64_t received_at_ns;
    /* Received: the TxNode of its publisher. Not looked at when it is published. */
    uint16_t publisher;
    /* How many of the bytes there are: 0 to UPS_EVENT_MAX, or UPS_DATA_MAX on a channel of messages. */
    uint16_t length;
    /* 0. */
    uint8_t reserved[4];
    /* What it says. */
    uint8_t data[UPS_DATA_MAX];
} msg_obj;

/* What a node is told at its start. Begin with UPS_SETTINGS_INIT. */
typedef struct ups_settings {
    /* The file that describes the cluster (TOML), or NULL: gives the quality of channels, their names and etags. */
    const char *cluster;
    /* The UID of the node; 0: one is drawn. One of the cluster's file brings its TxNode. */
    uint64_t uid;
    /* The TxNode, 0 to 126, in a cluster without broker; -1: the broker gives it. */
    int32_t tx_node;
    /* Bits a second; 0: 1 Mbit/s. Not looked at if there is a cluster's file, which says it. */
    uint32_t bit_rate;
    /* For how many milliseconds calls wait for the link and for the broker; 0: 5 s. */
    uint32_t patience_ms;
    /* 0. */
    uint32_t reserved;
} ups_settings;

#define UPS_SETTINGS_INIT { NULL, 0, -1, 0, 0, 0 }

/* The quality of a channel that no file describes. */
typedef struct ups_quality {
    /* Nanoseconds from publication until an event should have been sent. Soft real-time: not 0. */
    uint64_t deadline_ns;
    /* Nanoseconds from publication until an event is of no use any more. Soft real-time: not below the deadline.
       Non real-time: 0 if it keeps for ever. */
    uint64_t validity_ns;
    /* The etag in a cluster without broker, 1024 to 16383; 0: the broker gives it. */
    uint16_t etag;
    /* UPS_SOFT, UPS_NON_REAL_TIME or UPS_MESSAGES. */
    uint8_t channel_class;
    /* Non real-time: 0 the most important, to 4. */
    uint8_t importance;
    /* 0. */
    uint32_t reserved;
} ups_quality;

/* What happened on a channel at this node. All counts wrap. Whatever was lost here stands in one of them. */
typedef struct ups_counts {
    /* Taken from ups_publish(). */
    uint32_t published;
    /* Not taken; ups_publish() has said why. */
    uint32_t refused;
    /* Of the published, those that have been sent. */
    uint32_t sent;
    /* Of the published, those that expired before they were sent. */
    uint32_t expired;
    /* Put into the queue of a subscription; once for each. */
    uint32_t delivered;
    /* Dropped because the queue of a subscription was full. */
    uint32_t overflowed;
    /* Replaced by a later one, for a subscription that wants only the latest. */
    uint32_t replaced;
    /* Dropped because they did not carry what the channel says. */
    uint32_t malformed;
} ups_counts;

/*
 * Starts a node on a link, and waits until that is connected. Links: "sim:PATH", "slcan:DEVICE",
 * "socketcand:HOST:PORT[:BUS]", "can:INTERFACE", "log:FILE". A connection that is lost later is made again by itself.
 * settings: NULL for UPS_SETTINGS_INIT.
 * UPS_ERR_ARGUMENT, UPS_ERR_LINK.
 */
int ups_open(const char *link, const ups_settings *settings, ups_node *node);

/* Ends a node, with its subscriptions. Events that wait to be sent are discarded. UPS_ERR_HANDLE. */
int ups_close(ups_node node);

/* The subject of the channel of this name in the cluster's file. UPS_ERR_ARGUMENT: there is none. */
int ups_subject(ups_node node, const char *name, uint64_t *subject);

/*
 * Announces a channel, and waits until it can be published on. Does nothing for one that has been announced.
 * quality: NULL for what the cluster's file says, or else soft real-time with a deadline of 20 ms and a validity of
 * 80 ms.
 * UPS_ERR_ARGUMENT, UPS_ERR_HANDLE, UPS_ERR_REFUSED, UPS_ERR_NOT_BOUND.
 */
int ups_announce(ups_node node, uint64_t subject, const ups_quality *quality);

/* Gives up an announcement. Events that wait to be sent are discarded. UPS_ERR_ARGUMENT: there is none. */
int ups_withdraw(ups_node node, uint64_t subject);

/*
 * Publishes an event of now. The first one on a channel that has not been announced announces it, and may wait; no other
 * call waits. Up to 8 messages of a channel wait to be sent behind the one that is; UPS_ERR_QUEUE_FULL: one more.
 * UPS_ERR_ARGUMENT, UPS_ERR_HANDLE, UPS_ERR_TOO_LONG, UPS_ERR_DEADLINE, UPS_ERR_QUEUE_FULL, UPS_ERR_TOO_FAST, and those
 * of ups_announce(). The event is then not sent, and counted as refused if it got as far as its channel.
 */
int ups_publish(ups_node node, const msg_obj *msg);

/*
 * Subscribes to a channel. quality: as for ups_announce(). depth: this many events may wait, or one more that has been
 * made ready, and further ones are dropped and counted; 0: only the latest is kept.
 * UPS_ERR_ARGUMENT, UPS_ERR_HANDLE, UPS_ERR_REFUSED, UPS_ERR_NOT_BOUND.
 */
int ups_subscribe(ups_node node, uint64_t subject, const ups_quality *quality, uint8_t depth,
                  ups_subscription *subscription);

/* Ends a subscription, with the events that wait for it. Calls that wait return UPS_ERR_CLOSED. UPS_ERR_HANDLE. */
int ups_unsubscribe(ups_subscription subscription);

/*
 * Takes the next event. timeout_ms: for how long to wait; 0: not at all; below 0: for ever.
 * UPS_ERR_ARGUMENT, UPS_ERR_HANDLE, UPS_ERR_TIMEOUT, UPS_ERR_CLOSED.
 */
int ups_get_msg(ups_subscription subscription, msg_obj *msg, int32_t timeout_ms);

/*
 * A descriptor for poll(), select() or epoll that is readable while an event waits. Neither read from it nor close it;
 * ups_unsubscribe() closes it, so take it out of an epoll before. If several threads take events, another one may be
 * faster: then ups_get_msg() with a timeout of 0 says UPS_ERR_TIMEOUT.
 * Returns the descriptor, or UPS_ERR_HANDLE.
 */
int ups_descriptor(ups_subscription subscription);

/* What happened on a channel at this node. UPS_ERR_ARGUMENT: the node does not use it. */
int ups_counters(ups_node node, uint64_t subject, ups_counts *counts);

/* What the last error in this thread was, and what to do; "" if there was none. Valid until the next call. */
const char *ups_last_error(void);

#ifdef __cplusplus
}
#endif

/* The calls as the paper names them. */
#ifndef UPS_NO_SHORT_NAMES
static inline int publish(ups_node node, const msg_obj *msg) { return ups_publish(node, msg); }

static inline int subscribe(ups_node node, uint64_t subject, uint8_t depth, ups_subscription *subscription) {
    return ups_subscribe(node, subject, NULL, depth, subscription);
}

static inline int unsubscribe(ups_subscription subscription) { return ups_unsubscribe(subscription); }

static inline int get_msg(ups_subscription subscription, msg_obj *msg, int32_t timeout_ms) {
    return ups_get_msg(subscription, msg, timeout_ms);
}
#endif

#endif
