// One pool of threads for the process. The caller of `parallel` shares the work; a call from within such work, or while
// another thread has the pool, runs in its own thread.
#pragma once
#include <stdlib.h>
#if defined(__linux__)
#include <sched.h>
#endif
#if !defined(_WIN32)
#include <pthread.h>
#endif
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace supple {

struct Interrupted : std::exception {
    const char* what() const noexcept override { return "interrupted"; }
};

// The number of threads: SUPPLE_THREADS, or the number of CPUs available to this process.
inline int threads() {
    const char* asked = getenv("SUPPLE_THREADS");
    if (asked && *asked >= '1' && *asked <= '9') {
        char* end;
        long n = strtol(asked, &end, 10);
        if (*end == 0) return (int)(n < 1024 ? n : 1024);
    }
#if defined(__linux__)
    cpu_set_t set;
    if (sched_getaffinity(0, sizeof set, &set) == 0) return CPU_COUNT(&set);
#endif
    unsigned n = std::thread::hardware_concurrency();
    return n ? (int)n : 1;
}

class Pool {
public:
    typedef std::function<void(int item, int worker)> Body;

    explicit Pool(int n) : size(n) {
        for (int i = 1; i < n; i++) std::thread([this, i] { serve(i); }).detach();
    }
    // Call `body` for each item; `interrupted` is called at intervals by the caller's thread.
    void run(int count, const Body& body, bool (*interrupted)()) {
        job = &body;
        stop = false;
        failure = nullptr;
        next = 0;
        total = count;
        {
            std::lock_guard guard(lock);
            busy = size - 1;
            turn++;
        }
        wake.notify_all();
        auto looked = std::chrono::steady_clock::now();
        bool broken = false;
        work(0, [&] {
            auto now = std::chrono::steady_clock::now();
            if (!interrupted || now - looked < std::chrono::milliseconds(50)) return;
            looked = now;
            if (interrupted()) broken = stop = true;
        });
        std::unique_lock guard(lock);
        idle.wait(guard, [&] { return busy == 0; });
        if (broken) throw Interrupted();
        if (failure) std::rethrow_exception(failure);
    }
    const int size;
    std::mutex taken;

private:
    template <class F>
    void work(int worker, F&& between) {
        for (int i; !stop && (i = next++) < total;) {
            try {
                (*job)(i, worker);
            } catch (...) {
                std::lock_guard guard(lock);
                if (!failure) failure = std::current_exception();
                stop = true;
            }
            between();
        }
    }
    void serve(int worker) {
        inside() = true;
        for (unsigned long seen = 0;;) {
            std::unique_lock guard(lock);
            wake.wait(guard, [&] { return turn != seen; });
            seen = turn;
            guard.unlock();
            work(worker, [] {});
            guard.lock();
            if (--busy == 0) idle.notify_one();
        }
    }

    std::mutex lock;
    std::condition_variable wake, idle;
    const Body* job = nullptr;
    std::exception_ptr failure;
    std::atomic<int> next{0};
    std::atomic<bool> stop{false};
    int total = 0, busy = 0;
    unsigned long turn = 0;

public:
    static bool& inside() {  // true while this thread processes an item
        static thread_local bool yes = false;
        return yes;
    }
};

// Set by the bindings: true if Python wants to interrupt the work.
inline bool (*interrupted)() = nullptr;

// Call `child` in every process forked from this one.
inline void after_fork(void (*child)()) {
#if !defined(_WIN32)
    pthread_atfork(nullptr, nullptr, child);
#endif
}

// Never destroyed: threads of a pool end with the process. A forked child has none of them.
struct Shared {
    std::mutex making;
    Pool* pool = nullptr;
};
inline Shared*& shared() {
    static Shared* all = [] {
        after_fork([] { shared() = new Shared; });
        return new Shared;
    }();
    return all;
}

// Call body(item, worker) for the items 0 to count - 1, where worker counts from 0 to threads() - 1.
//
// Raises Interrupted if Python was interrupted, and the exceptions of a body.
inline void parallel(int count, const Pool::Body& body) {
    Shared*& all = shared();
    int n = threads();
    if (n > 1 && count > 1 && !Pool::inside()) {
        Pool* own;
        {
            std::lock_guard guard(all->making);
            if (!all->pool || (all->pool->size != n && all->pool->taken.try_lock())) {
                if (all->pool) all->pool->taken.unlock();  // its threads stay idle; their number seldom changes
                all->pool = new Pool(n);
            }
            own = all->pool;
        }
        if (own->taken.try_lock()) {
            std::lock_guard guard(own->taken, std::adopt_lock);
            Pool::inside() = true;
            struct Leave {
                ~Leave() { Pool::inside() = false; }
            } leave;
            own->run(count, body, interrupted);
            return;
        }
    }
    auto looked = std::chrono::steady_clock::now();
    for (int i = 0; i < count; i++) {
        body(i, 0);
        auto now = std::chrono::steady_clock::now();
        if (interrupted && now - looked >= std::chrono::milliseconds(50)) {
            looked = now;
            if (!Pool::inside() && interrupted()) throw Interrupted();
        }
    }
}

}  // namespace supple
