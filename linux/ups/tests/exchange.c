/* The library as a program in C uses it. The test in c.rs serves the segment and the peer:
   what is published on COMMAND it answers on ANSWER with the bytes in reverse; a command { 0xB0, n } it answers n times.
   Usage: exchange exchange|messages|inputs|threads|planned LINK [CLUSTER] */
#define _GNU_SOURCE
#include "ups.h"

#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define COMMAND 0x51u
#define ANSWER 0x52u
#define JOURNAL 0x53u
#define MS 1000000u

#define CHECK(holds)                                                                                        \
    do {                                                                                                    \
        if (!(holds)) {                                                                                     \
            fprintf(stderr, "%s:%d: %s; last error: %s\n", __FILE__, __LINE__, #holds, ups_last_error());   \
            exit(1);                                                                                        \
        }                                                                                                   \
    } while (0)

/* The code, and a word of the text. */
static void check_error(int line, int code, int expected, const char *word) {
    if (code != expected || strstr(ups_last_error(), word) == NULL) {
        fprintf(stderr, "line %d: %d instead of %d, and: %s\n", line, code, expected, ups_last_error());
        exit(1);
    }
}
#define ERROR(call, code, word) check_error(__LINE__, (call), (code), (word))

static const ups_quality command_quality = { 50 * MS, 200 * MS, 5001, UPS_SOFT, 0, 0 };
static const ups_quality answer_quality = { 50 * MS, 200 * MS, 5002, UPS_SOFT, 0, 0 };

static uint64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

static ups_node open_node(const char *link, int tx_node) {
    ups_node node = 0;
    ups_settings settings = UPS_SETTINGS_INIT;
    settings.tx_node = tx_node;
    settings.patience_ms = 60000;
    CHECK(ups_open(link, &settings, &node) == UPS_OK);
    CHECK(node != 0);
    return node;
}

static msg_obj command(unsigned number) {
    msg_obj msg;
    memset(&msg, 0, sizeof msg);
    msg.subject = COMMAND;
    msg.length = 3;
    msg.data[0] = (uint8_t)number;
    msg.data[1] = (uint8_t)(number >> 8);
    msg.data[2] = 0xEE;
    return msg;
}

/* An event on a busy machine may expire before it is sent; then it is published again. */
static msg_obj ask(ups_node node, ups_subscription answers, const msg_obj *msg, int with_descriptor) {
    msg_obj answer;
    for (;;) {
        int code;
        CHECK(publish(node, msg) == UPS_OK);
        if (with_descriptor) {
            struct pollfd wait = { ups_descriptor(answers), POLLIN, 0 };
            CHECK(wait.fd >= 0);
            if (poll(&wait, 1, 5000) == 1) {
                CHECK(get_msg(answers, &answer, 0) == UPS_OK);
                return answer;
            }
        } else if ((code = get_msg(answers, &answer, 5000)) == UPS_OK) {
            return answer;
        } else {
            CHECK(code == UPS_ERR_TIMEOUT);
        }
        ups_counts counts;
        CHECK(ups_counters(node, COMMAND, &counts) == UPS_OK);
        CHECK(counts.expired > 0);
    }
}

static void run_exchange(const char *link) {
    ups_node node = open_node(link, 7);
    ups_subscription answers = 0;
    CHECK(ups_announce(node, COMMAND, &command_quality) == UPS_OK);
    CHECK(ups_subscribe(node, ANSWER, &answer_quality, 16, &answers) == UPS_OK);
    for (unsigned number = 0; number < 200; number++) {
        msg_obj msg = command(number);
        msg.deadline_ns = 30 * MS;
        msg.validity_ns = 100 * MS;
        uint64_t before = now_ns();
        msg_obj answer = ask(node, answers, &msg, number % 2);
        CHECK(answer.subject == ANSWER && answer.publisher == 1 && answer.length == 3);
        CHECK(answer.data[0] == 0xEE && answer.data[1] == msg.data[1] && answer.data[2] == msg.data[0]);
        CHECK(answer.received_at_ns >= before && answer.received_at_ns <= now_ns());
        CHECK(answer.deadline_ns == 0 && answer.reserved[0] == 0 && answer.data[3] == 0);
    }

    /* What does not fit is counted. */
    ups_subscription few = 0, latest = 0;
    CHECK(ups_subscribe(node, ANSWER, &answer_quality, 2, &few) == UPS_OK);
    CHECK(ups_subscribe(node, ANSWER, &answer_quality, 0, &latest) == UPS_OK);
    msg_obj burst = command(0), got;
    burst.length = 2;
    burst.data[0] = 0xB0;
    burst.data[1] = 12;
    for (int i = 0; i < 12; i++) {
        /* The twelve are published one by one, each when the one before it has been sent. */
        if (i == 0) got = ask(node, answers, &burst, 1);
        else CHECK(get_msg(answers, &got, 60000) == UPS_OK);
        CHECK(got.data[0] == i);
    }
    ups_counts counts;
    CHECK(ups_counters(node, ANSWER, &counts) == UPS_OK);
    CHECK(counts.overflowed == 12 - 2);
    CHECK(counts.replaced == 12 - 1);
    for (int i = 0; i < 2; i++) {
        CHECK(get_msg(few, &got, 0) == UPS_OK);
        CHECK(got.data[0] == i);
    }
    ERROR(get_msg(few, &got, 0), UPS_ERR_TIMEOUT, "within the time");
    ERROR(get_msg(few, &got, 20), UPS_ERR_TIMEOUT, "within the time");
    struct pollfd quiet = { ups_descriptor(few), POLLIN, 0 };
    CHECK(poll(&quiet, 1, 0) == 0);
    CHECK(get_msg(latest, &got, 0) == UPS_OK);
    CHECK(got.data[0] == 11);
    CHECK(get_msg(latest, &got, 0) == UPS_ERR_TIMEOUT);

    CHECK(unsubscribe(few) == UPS_OK);
    ERROR(get_msg(few, &got, 0), UPS_ERR_HANDLE, "no subscription");
    ERROR(unsubscribe(few), UPS_ERR_HANDLE, "has been closed");
    CHECK(ups_withdraw(node, COMMAND) == UPS_OK);
    ERROR(ups_withdraw(node, COMMAND), UPS_ERR_ARGUMENT, "has been announced");
    CHECK(ups_close(node) == UPS_OK);
    ERROR(ups_close(node), UPS_ERR_HANDLE, "no node");
    ERROR(get_msg(answers, &got, 0), UPS_ERR_HANDLE, "no subscription");
    ERROR(publish(node, &burst), UPS_ERR_HANDLE, "no node");
}

static void run_inputs(const char *link) {
    ups_node node = 77;
    ups_settings settings = UPS_SETTINGS_INIT;
    ERROR(ups_open(NULL, NULL, &node), UPS_ERR_ARGUMENT, "`link` is NULL");
    ERROR(ups_open(link, NULL, NULL), UPS_ERR_ARGUMENT, "`node` is NULL");
    ERROR(ups_open("can0", NULL, &node), UPS_ERR_ARGUMENT, "no kind of link");
    ERROR(ups_open("usb:1", NULL, &node), UPS_ERR_ARGUMENT, "no link of kind");
    ERROR(ups_open("\xFF\xFE", NULL, &node), UPS_ERR_ARGUMENT, "no UTF-8");
    char *huge = malloc(1 << 20);
    CHECK(huge != NULL);
    memset(huge, 'x', 1 << 20);
    huge[(1 << 20) - 1] = 0;
    ERROR(ups_open(huge, NULL, &node), UPS_ERR_ARGUMENT, "longer than");
    settings.cluster = huge;
    ERROR(ups_open(link, &settings, &node), UPS_ERR_ARGUMENT, "longer than");
    settings.cluster = "/nowhere.toml";
    ERROR(ups_open(link, &settings, &node), UPS_ERR_ARGUMENT, "/nowhere.toml cannot be read");
    settings = (ups_settings)UPS_SETTINGS_INIT;
    settings.tx_node = 127;
    ERROR(ups_open(link, &settings, &node), UPS_ERR_ARGUMENT, "0 to 126");
    settings.tx_node = 7;
    settings.bit_rate = 5;
    ERROR(ups_open(link, &settings, &node), UPS_ERR_ARGUMENT, "10000 to 1000000");
    settings.bit_rate = 0;
    settings.patience_ms = 30;
    ERROR(ups_open("sim:/nowhere/segment", &settings, &node), UPS_ERR_LINK, "no server answers");
    ERROR(ups_open("log:/nowhere.log", &settings, &node), UPS_ERR_LINK, "cannot be opened");
    ERROR(ups_open("slcan:/dev/null", &settings, &node), UPS_ERR_LINK, "no serial device");
    CHECK(node == 77);

    node = open_node(link, 7);
    ups_subscription subscription = 0;
    msg_obj msg = command(1);
    uint64_t subject = 0;
    ups_counts counts;
    ERROR(ups_subject(node, "drive", &subject), UPS_ERR_ARGUMENT, "without the cluster's file");
    ERROR(ups_subject(node, NULL, &subject), UPS_ERR_ARGUMENT, "`name` is NULL");
    ERROR(ups_subject(node, "0x51", NULL), UPS_ERR_ARGUMENT, "`subject` is NULL");
    CHECK(ups_subject(node, "0x51", &subject) == UPS_OK && subject == COMMAND);
    ERROR(ups_announce(node, 0, NULL), UPS_ERR_ARGUMENT, "subject is 0");
    ups_quality quality = command_quality;
    quality.deadline_ns = 0;
    ERROR(ups_announce(node, COMMAND, &quality), UPS_ERR_ARGUMENT, "deadline of zero");
    quality = command_quality;
    quality.validity_ns = 1;
    ERROR(ups_announce(node, COMMAND, &quality), UPS_ERR_ARGUMENT, "shorter than the deadline");
    quality.validity_ns = UINT64_MAX;
    ERROR(ups_announce(node, COMMAND, &quality), UPS_ERR_ARGUMENT, "longer than a year");
    quality = command_quality;
    quality.etag = 99;
    ERROR(ups_announce(node, COMMAND, &quality), UPS_ERR_ARGUMENT, "1024 to 16383");
    quality.etag = 0xFFFF;
    ERROR(ups_announce(node, COMMAND, &quality), UPS_ERR_ARGUMENT, "1024 to 16383");
    quality = command_quality;
    quality.channel_class = 3;
    ERROR(ups_announce(node, COMMAND, &quality), UPS_ERR_ARGUMENT, "UPS_NON_REAL_TIME or UPS_MESSAGES");
    quality.channel_class = UPS_NON_REAL_TIME;
    quality.importance = 5;
    ERROR(ups_announce(node, COMMAND, &quality), UPS_ERR_ARGUMENT, "0 to 4");
    CHECK(ups_announce(node, COMMAND, &command_quality) == UPS_OK);
    ERROR(ups_subscribe(node, COMMAND, NULL, 4, &subscription), UPS_ERR_REFUSED, "");
    ERROR(ups_subscribe(node, ANSWER, &answer_quality, 4, NULL), UPS_ERR_ARGUMENT, "`subscription` is NULL");
    ERROR(publish(node, NULL), UPS_ERR_ARGUMENT, "`msg` is NULL");
    msg.length = UPS_EVENT_MAX + 1;
    ERROR(publish(node, &msg), UPS_ERR_TOO_LONG, "not sent");
    msg = command(1);
    msg.deadline_ns = 2 * MS;
    msg.validity_ns = 1 * MS;
    ERROR(publish(node, &msg), UPS_ERR_DEADLINE, "not sent");
    msg.deadline_ns = UINT64_MAX;
    ERROR(publish(node, &msg), UPS_ERR_ARGUMENT, "longer than a year");
    msg = command(1);
    msg.subject = 0;
    ERROR(publish(node, &msg), UPS_ERR_ARGUMENT, "subject is 0");
    ERROR(publish(0, &msg), UPS_ERR_HANDLE, "no node 0");
    ERROR(publish(UINT64_MAX, &msg), UPS_ERR_HANDLE, "no node");
    ERROR(get_msg(node, &msg, 0), UPS_ERR_HANDLE, "no subscription");
    ERROR(ups_descriptor(node), UPS_ERR_HANDLE, "no subscription");
    ERROR(ups_counters(node, ANSWER, &counts), UPS_ERR_ARGUMENT, "does not use");
    ERROR(ups_counters(node, COMMAND, NULL), UPS_ERR_ARGUMENT, "`counts` is NULL");
    CHECK(ups_subscribe(node, ANSWER, &answer_quality, 4, &subscription) == UPS_OK);
    ERROR(get_msg(subscription, NULL, 0), UPS_ERR_ARGUMENT, "`msg` is NULL");
    ERROR(ups_close(subscription), UPS_ERR_HANDLE, "no node");
    CHECK(ups_close(node) == UPS_OK);

    /* Nobody hosts a broker here. */
    settings = (ups_settings)UPS_SETTINGS_INIT;
    settings.patience_ms = 200;
    CHECK(ups_open(link, &settings, &node) == UPS_OK);
    ERROR(ups_announce(node, 0x60, NULL), UPS_ERR_NOT_BOUND, "no broker has answered");
    msg = command(1);
    msg.subject = 0x61;
    ERROR(publish(node, &msg), UPS_ERR_NOT_BOUND, "no broker has answered");
    ERROR(ups_subscribe(node, 0x62, NULL, 1, &subscription), UPS_ERR_NOT_BOUND, "no broker has answered");
    CHECK(ups_close(node) == UPS_OK);
    free(huge);
}

#define THREADS 4
#define EACH 50

static ups_node shared_node;
static ups_subscription shared_answers;
static int closed_while_waiting;

static void *publish_some(void *argument) {
    unsigned thread = *(unsigned *)argument;
    for (unsigned i = 0; i < EACH; i++) {
        msg_obj msg = command(thread * EACH + i);
        int code;
        while ((code = publish(shared_node, &msg)) == UPS_ERR_QUEUE_FULL) {
            struct timespec pause = { 0, MS };
            nanosleep(&pause, NULL);
        }
        CHECK(code == UPS_OK);
    }
    return NULL;
}

static unsigned seen[THREADS * EACH];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static void *take_until_closed(void *argument) {
    (void)argument;
    msg_obj msg;
    int code;
    while ((code = get_msg(shared_answers, &msg, -1)) == UPS_OK) {
        unsigned number = msg.data[2] | (unsigned)msg.data[1] << 8;
        CHECK(number < THREADS * EACH);
        pthread_mutex_lock(&lock);
        seen[number]++;
        pthread_mutex_unlock(&lock);
    }
    CHECK(code == UPS_ERR_CLOSED || code == UPS_ERR_HANDLE);
    pthread_mutex_lock(&lock);
    closed_while_waiting += code == UPS_ERR_CLOSED;
    pthread_mutex_unlock(&lock);
    return NULL;
}

static unsigned total(void) {
    unsigned sum = 0;
    pthread_mutex_lock(&lock);
    for (unsigned i = 0; i < THREADS * EACH; i++) {
        CHECK(seen[i] <= 1);
        sum += seen[i];
    }
    pthread_mutex_unlock(&lock);
    return sum;
}

static void run_threads(const char *link) {
    pthread_t publishers[THREADS], takers[2];
    unsigned numbers[THREADS];
    shared_node = open_node(link, 7);
    /* They keep for ever, so none expires on a busy machine. */
    ups_quality lasting = { 0, 0, 5001, UPS_NON_REAL_TIME, 2, 0 };
    ups_quality lasting_answers = { 0, 0, 5002, UPS_NON_REAL_TIME, 2, 0 };
    CHECK(ups_announce(shared_node, COMMAND, &lasting) == UPS_OK);
    CHECK(ups_subscribe(shared_node, ANSWER, &lasting_answers, 250, &shared_answers) == UPS_OK);
    for (unsigned i = 0; i < 2; i++) CHECK(pthread_create(&takers[i], NULL, take_until_closed, NULL) == 0);
    for (unsigned i = 0; i < THREADS; i++) {
        numbers[i] = i;
        CHECK(pthread_create(&publishers[i], NULL, publish_some, &numbers[i]) == 0);
    }
    for (unsigned i = 0; i < THREADS; i++) CHECK(pthread_join(publishers[i], NULL) == 0);
    for (int i = 0; i < 60000 && total() < THREADS * EACH; i++) {
        struct timespec pause = { 0, MS };
        nanosleep(&pause, NULL);
    }
    CHECK(total() == THREADS * EACH);
    /* Both wait now, or are about to. */
    struct timespec pause = { 0, 100 * MS };
    nanosleep(&pause, NULL);
    CHECK(unsubscribe(shared_answers) == UPS_OK);
    for (unsigned i = 0; i < 2; i++) CHECK(pthread_join(takers[i], NULL) == 0);
    printf("%d of 2 were told while they waited\n", closed_while_waiting);
    CHECK(ups_close(shared_node) == UPS_OK);
}

/* Two nodes of this program. */
static void run_messages(const char *link) {
    ups_node base = open_node(link, 7), display = open_node(link, 8);
    ups_quality quality = { 0, 0, 5003, UPS_MESSAGES, 4, 0 };
    ups_subscription journal;
    static const uint16_t lengths[] = { 8, 0, 9, 300, UPS_DATA_MAX };
    static msg_obj msg, got;
    CHECK(ups_subscribe(display, JOURNAL, &quality, 16, &journal) == UPS_OK);
    CHECK(ups_announce(base, JOURNAL, &quality) == UPS_OK);
    msg.subject = JOURNAL;
    for (size_t i = 0; i < sizeof lengths / sizeof *lengths; i++) {
        msg.length = lengths[i];
        for (unsigned at = 0; at < UPS_DATA_MAX; at++) {
            msg.data[at] = at < msg.length ? (uint8_t)(at * 31 + i) : 0;
        }
        CHECK(publish(base, &msg) == UPS_OK);
        for (;;) {
            int code = get_msg(journal, &got, 2000);
            /* Who has just joined may miss the first one. */
            if (code == UPS_ERR_TIMEOUT && i == 0) CHECK(publish(base, &msg) == UPS_OK);
            else CHECK(code == UPS_OK || code == UPS_ERR_TIMEOUT);
            if (code == UPS_OK && got.length == msg.length) break;
        }
        CHECK(memcmp(got.data, msg.data, UPS_DATA_MAX) == 0);
        CHECK(got.subject == JOURNAL && got.publisher == 7);
    }
    msg.length = UPS_DATA_MAX + 1;
    ERROR(publish(base, &msg), UPS_ERR_TOO_LONG, "not sent");
    msg.length = 9;
    msg.deadline_ns = MS;
    ERROR(publish(base, &msg), UPS_ERR_ARGUMENT, "no deadline");
    CHECK(ups_close(base) == UPS_OK && ups_close(display) == UPS_OK);
}

/* The peer sends the hard real-time channel `drive` and hears `joint`. */
static void run_planned(const char *link, const char *cluster) {
    ups_settings settings = UPS_SETTINGS_INIT;
    settings.cluster = cluster;
    settings.uid = 0xB0A0000000000005u;
    settings.patience_ms = 60000;
    ups_node node;
    uint64_t drive, joint, missing = 0;
    CHECK(ups_open(link, &settings, &node) == UPS_OK);
    CHECK(ups_subject(node, "drive", &drive) == UPS_OK && drive == 0xB0A01C0000000001u);
    CHECK(ups_subject(node, "joint", &joint) == UPS_OK);
    ERROR(ups_subject(node, "drvie", &missing), UPS_ERR_ARGUMENT, "not in the cluster's file");
    ERROR(ups_announce(node, joint, &command_quality), UPS_ERR_ARGUMENT, "give none");
    ERROR(ups_announce(node, drive, NULL), UPS_ERR_REFUSED, "hard real-time");
    ups_subscription drives;
    msg_obj msg;
    CHECK(subscribe(node, drive, 8, &drives) == UPS_OK);
    CHECK(get_msg(drives, &msg, 60000) == UPS_OK);
    CHECK(msg.publisher == 1 && msg.length >= 2 && msg.data[0] == 0x12 && msg.data[1] == 0x34);
    memset(&msg, 0, sizeof msg);
    msg.subject = joint;
    msg.length = 5;
    memcpy(msg.data, "\x01\x02\x03\x04\x05", 5);
    CHECK(publish(node, &msg) == UPS_OK);
    ups_counts counts;
    for (int i = 0; i < 60000; i++) {
        CHECK(ups_counters(node, joint, &counts) == UPS_OK);
        if (counts.sent + counts.expired == 1) break;
        struct timespec pause = { 0, MS };
        nanosleep(&pause, NULL);
    }
    CHECK(counts.published == 1 && counts.sent + counts.expired == 1);
    CHECK(ups_close(node) == UPS_OK);
}

int main(int count, char **words) {
    if (count < 3) return 2;
    CHECK(strcmp(ups_last_error(), "") == 0);
    if (strcmp(words[1], "exchange") == 0) run_exchange(words[2]);
    else if (strcmp(words[1], "messages") == 0) run_messages(words[2]);
    else if (strcmp(words[1], "inputs") == 0) run_inputs(words[2]);
    else if (strcmp(words[1], "threads") == 0) run_threads(words[2]);
    else if (strcmp(words[1], "planned") == 0 && count == 4) run_planned(words[2], words[3]);
    else return 2;
    puts("all is well");
    return 0;
}
